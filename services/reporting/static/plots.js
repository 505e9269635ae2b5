// Plotly renderer of the plot descriptions in services/reporting/plots/catalogue.py; it holds no plot-specific code.
//
// A run is {name, colour, tables: {name: {column: [numbers]}}, values: {name: number}, marks: [{t_s, node, text}]}; its
// colour is null where there is one run alone.
"use strict";

const Plots = (() => {
  const DASHES = { line: "solid", dashed: "dash", dotted: "dot" };
  const COMPARED_DASHES = ["solid", "dash", "dot"];
  const GRID = "#e6e8eb";
  const INK = "#2b2f33";
  const MARK = "#a0522d"; // the same colour as in palette.py
  const CONFIG = { displayModeBar: false, responsive: true, displaylogo: false };

  const column = (run, series, name) => (run.tables[series.table] || {})[name] || [];

  function transparent(hex, alpha) {
    const part = (i) => parseInt(hex.slice(i, i + 2), 16);
    return `rgba(${part(1)}, ${part(3)}, ${part(5)}, ${alpha})`;
  }

  function band(run, series) {
    const low = [], high = [];
    const x = column(run, series, series.x), y = column(run, series, series.y);
    const xHigh = series.x_high ? column(run, series, series.x_high) : x;
    const yHigh = series.y_high ? column(run, series, series.y_high) : y;
    for (let i = 0; i < x.length; i++) {
      if ([x[i], y[i], xHigh[i], yHigh[i]].some((value) => value === null || value === undefined)) continue;
      low.push([x[i], y[i]]);
      high.push([xHigh[i], yHigh[i]]);
    }
    const outline = low.concat(high.reverse());
    return {
      type: "scatter", mode: "lines", fill: "toself", hoverinfo: "skip", line: { width: 0 },
      x: outline.map((point) => point[0]), y: outline.map((point) => point[1]),
      fillcolor: transparent(series.colour, 0.16),
    };
  }

  // Return the first row at t >= 0; 0 if there is none yet.
  function start(run, series) {
    return Math.max(0, column(run, series, "t_s").findIndex((t) => t >= 0));
  }

  function drawn(plot, run, series) {
    const first = plot.from_start ? start(run, series) : 0;
    const trace = {
      type: "scatter", name: series.label,
      x: column(run, series, series.x).slice(first), y: column(run, series, series.y).slice(first),
      hovertemplate: "%{x:.4~g}, %{y:.4~g}",
    };
    if (series.style === "cross") {
      const marker = { symbol: "cross-thin", size: 11, line: { width: 2, color: series.colour } };
      return { ...trace, mode: "markers", marker };
    }
    return { ...trace, mode: "lines", line: { color: series.colour, dash: DASHES[series.style], width: 1.6 } };
  }

  function level(run, one, ends) {
    const value = run.values[one.value];
    if (value === undefined || ends === null) return [];
    return [{ type: "scatter", mode: "lines", name: one.label, x: ends, y: [value, value],
      line: { color: one.colour, dash: "dot", width: 1.2 }, hovertemplate: "%{y:.4~g}" }];
  }

  function ofOneRun(plot, run) {
    const series = plot.series.map((one) => (one.style === "band" ? band(run, one) : drawn(plot, run, one)));
    const ends = extent(series, "x");
    return plot.levels.flatMap((one) => level(run, one, ends)).concat(series);
  }

  // Shift a track to start at zero, to compare runs with different starting points.
  function fromItsStart(trace) {
    for (const axis of ["x", "y"]) {
      const zero = trace[axis].find((value) => value !== null) || 0;
      trace[axis] = trace[axis].map((value) => (value === null ? null : value - zero));
    }
  }

  function ofSeveral(plot, runs) {
    const compared = plot.series.filter((series) => series.compared);
    return runs.flatMap((run) => compared.map((series, i) => {
      const trace = drawn(plot, run, series);
      if (plot.equal) fromItsStart(trace);
      trace.line = { color: run.colour, dash: COMPARED_DASHES[i % COMPARED_DASHES.length], width: 1.5 };
      trace.name = `${run.name}: ${series.label}`;
      trace.hovertemplate = `%{x:.4~g}, %{y:.4~g}<extra>${run.name}: ${series.label}</extra>`;
      return trace;
    }));
  }

  function marks(run) {
    const x = [], y = [], text = [];
    for (const mark of run.marks) {
      const words = `${mark.t_s.toFixed(1)} s  ${mark.node}: ${mark.text}`;
      x.push(mark.t_s, mark.t_s, null);
      y.push(0, 1, null);
      text.push(words, words, "");
    }
    return { type: "scatter", mode: "lines", name: "events", x, y, text, yaxis: "y2", hovertemplate: "%{text}<extra></extra>",
      line: { color: transparent(MARK, 0.3), width: 1 } };
  }

  function extent(traces, axis) {
    let least = Infinity, most = -Infinity;
    for (const trace of traces) {
      for (const value of trace[axis]) {
        if (value === null || value === undefined) continue; // a gap
        if (value < least) least = value;
        if (value > most) most = value;
      }
    }
    return least <= most ? [least, most] : null;
  }

  // Return the range of an axis with a margin, at least min_span long.
  function range(axis, traces, name) {
    const ends = extent(traces, name);
    if (ends === null) return [0, 1];
    let [least, most] = ends;
    if (axis.log) return [Math.log10(least) - 0.15, Math.log10(most) + 0.15];
    const missing = Math.max(0, (axis.min_span || 1e-6) - (most - least)) / 2;
    const margin = (name === "x" && axis.label.startsWith("time") ? 0.01 : 0.05) * (most - least + 2 * missing);
    least -= missing + margin;
    most += missing + margin;
    return axis.downwards ? [most, least] : [least, most];
  }

  function axisLayout(axis, traces, name) {
    return {
      title: { text: axis.label, standoff: 4, font: { size: 11 } }, range: range(axis, traces, name),
      type: axis.log ? "log" : "linear", gridcolor: GRID, zeroline: false, linecolor: "#c9cdd2", showline: true,
      ticks: "outside", ticklen: 3, tickcolor: "#c9cdd2", nticks: 6, automargin: true,
      ...(axis.log ? { dtick: 1, tickformat: "~g" } : {}),
    };
  }

  // Return the common range of all time axes, so that simultaneous values are aligned.
  function times(runs) {
    const columns = runs.flatMap((run) => Object.values(run.tables)).map((table) => ({ x: table.t_s || [] }));
    return range({ label: "time" }, columns, "x");
  }

  function layout(plot, traces, times, empty) {
    const x = axisLayout(plot.x, traces, "x");
    const y = axisLayout(plot.y, traces, "y");
    const made = {
      margin: { l: 46, r: 8, t: 6, b: 34 }, showlegend: false, hovermode: "closest", uirevision: "kept",
      font: { family: "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", size: 11, color: INK },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "#ffffff",
      xaxis: plot.over_time ? { ...x, range: times } : x, yaxis: plot.equal ? { ...y, scaleanchor: "x", scaleratio: 1 } : y,
      annotations: empty ? [{ text: plot.empty, xref: "paper", yref: "paper", x: 0.5, y: 0.5, showarrow: false,
        font: { size: 12, color: "#767676" } }] : [],
    };
    if (plot.over_time) made.yaxis2 = { overlaying: "y", range: [0, 1], visible: false, fixedrange: true };
    return made;
  }

  function draw(place, plot, runs, timeRange) {
    const several = runs.length > 1;
    const traces = several ? ofSeveral(plot, runs) : ofOneRun(plot, runs[0]);
    const shown = traces.filter((trace) => trace.y.some((value) => value !== null));
    const made = layout(plot, shown, timeRange, shown.length === 0);
    if (plot.over_time && !several) shown.push(marks(runs[0]));
    return Plotly.react(place, shown, made, CONFIG);
  }

  function chip(label, colour, style) {
    const item = document.createElement("li");
    const line = document.createElement("span");
    line.className = `line ${style}`;
    line.style.color = colour;
    item.append(line, document.createTextNode(label));
    return item;
  }

  // Return the legend of a plot. With several runs it explains the dashes; one common legend explains the colours.
  function legend(plot, several) {
    const list = document.createElement("ul");
    list.className = "legend";
    if (several) {
      const compared = plot.series.filter((series) => series.compared);
      const styles = ["line", "dashed", "dotted"];
      if (plot.equal) list.append(document.createTextNode("each run from its own start"));
      if (compared.length > 1) list.append(...compared.map((one, i) => chip(one.label, INK, styles[i % 3])));
      return list;
    }
    for (const series of plot.series.filter((one) => one.label)) list.append(chip(series.label, series.colour, series.style));
    const labels = new Set();
    for (const one of plot.levels) {
      if (!labels.has(one.label)) list.append(chip(one.label, one.colour, "dotted"));
      labels.add(one.label);
    }
    return list;
  }

  // Add a section for each plot to `parent` and return the elements to draw in, by name.
  function frames(parent, plots, several) {
    const places = new Map();
    for (const plot of plots) {
      const section = document.createElement("section");
      section.className = "panel";
      section.id = `panel-${plot.name}`;
      const title = document.createElement("h2");
      title.textContent = plot.title;
      if (plot.note) title.title = plot.note;
      const place = document.createElement("div");
      place.className = "plot";
      place.id = `plot-${plot.name}`;
      section.append(title, legend(plot, several), place);
      parent.append(section);
      places.set(plot.name, place);
    }
    return places;
  }

  return { frames, draw, chip, times, MARK };
})();
