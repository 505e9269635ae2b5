// Plotly renderer of the plot descriptions in services/reporting/plots/catalogue.py; it holds no plot-specific code.
//
// A run is {name, colour, tables: {name: {column: [numbers]}}, values: {name: number}, marks: [{t_s, node, text}]}; its
// colour is null where there is one run alone.
"use strict";

const Plots = (() => {
  const DASHES = { line: "solid", dashed: "dash", dotted: "dot" };
  const COMPARED_DASHES = ["solid", "dash", "dot"];
  const SYMBOLS = { cross: "cross-thin", point: "circle", dot: "circle", ring: "circle-open" };
  const SIZES = { cross: 11, point: 4, dot: 9, ring: 9 };
  const MARK = "#a0522d"; // the same colour as in palette.py
  const NO_DATA = "no data yet"; // the same text as in description.py
  const CONFIG = { displayModeBar: false, displaylogo: false };
  const GAP_S = 1, GAP_STEPS = 5; // a line ends where data are missing for longer than both

  const darkness = window.matchMedia("(prefers-color-scheme: dark)");
  let darkColours = {}; // of palette.py, by the light one
  const colour = (hex) => (darkness.matches && darkColours[hex]) || hex;
  // Return a font size (px) that grows with the size of text that the reader has set in the browser.
  const letters = (px) => px * parseFloat(getComputedStyle(document.documentElement).fontSize) / 16;
  const theme = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  const column = (run, series, name) => (run.tables[series.table] || {})[name] || [];
  const missing = (value) => value === null || value === undefined;

  function element(tag, text, name) {
    const made = document.createElement(tag);
    made.textContent = text;
    if (name) made.className = name;
    return made;
  }

  function button(text, onClick, { kind = "small", label = "" } = {}) {
    const made = element("button", text, kind);
    made.type = "button";
    if (label) made.setAttribute("aria-label", label);
    made.addEventListener("click", onClick);
    return made;
  }

  function transparent(hex, alpha) {
    const part = (i) => parseInt(hex.slice(i, i + 2), 16);
    return `rgba(${part(1)}, ${part(3)}, ${part(5)}, ${alpha})`;
  }

  // --- data of a series ---------------------------------------------------------------------------------------------

  // Return the rows before which data are missing: later than GAP_S and GAP_STEPS mean steps.
  function gaps(times) {
    const steps = times.filter((t, i) => i > 0 && t > times[i - 1]).length; // several points may have one time
    const mean = steps > 1 ? (times[times.length - 1] - times[0]) / steps : 0;
    const longest = Math.max(GAP_S, GAP_STEPS * mean);
    return new Set(times.flatMap((t, i) => (i > 0 && t - times[i - 1] > longest ? [i] : [])));
  }

  // Insert a gap into a line at each of these rows.
  const broken = (values, rows) => values.flatMap((value, i) => (rows.has(i) ? [null, value] : [value]));

  function band(run, series) {
    const x = column(run, series, series.x), y = column(run, series, series.y);
    const xHigh = series.x_high ? column(run, series, series.x_high) : x;
    const yHigh = series.y_high ? column(run, series, series.y_high) : y;
    const ends = gaps(column(run, series, "t_s"));
    const outline = [];
    let low = [], high = [];
    const close = () => {
      if (low.length) outline.push(...low, ...high.reverse(), [null, null]);
      low = [];
      high = [];
    };
    for (let i = 0; i < x.length; i++) {
      if (ends.has(i)) close();
      if ([x[i], y[i], xHigh[i], yHigh[i]].some(missing)) continue;
      low.push([x[i], y[i]]);
      high.push([xHigh[i], yHigh[i]]);
    }
    close();
    return {
      type: "scatter", mode: "lines", fill: "toself", hoverinfo: "skip", line: { width: 0 }, series,
      x: outline.map((point) => point[0]), y: outline.map((point) => point[1]),
      fillcolor: transparent(colour(series.colour), 0.16), name: series.label, showlegend: series.label !== "",
      edges: { x, y, ...(series.x_high ? { xHigh } : { yHigh }) },
    };
  }

  // Return the first row at t >= 0; 0 if there is none yet.
  const start = (times) => Math.max(0, times.findIndex((t) => t >= 0));

  function line(plot, run, series) {
    const times = column(run, series, "t_s");
    const first = plot.from_start ? start(times) : 0;
    const cells = (name) => column(run, series, name).slice(first);
    const ends = series.style in DASHES ? gaps(times.slice(first)) : new Set();
    const trace = {
      type: "scatter", name: series.label, x: broken(cells(series.x), ends), y: broken(cells(series.y), ends), series,
      hovertemplate: "%{x:.4~g}, %{y:.4~g}",
    };
    if (series.style in SYMBOLS) {
      const stroke = { width: series.style === "point" ? 0 : 2, color: colour(series.colour) };
      const marker = { symbol: SYMBOLS[series.style], size: SIZES[series.style], color: stroke.color, line: stroke };
      return { ...trace, mode: "markers", marker };
    }
    return { ...trace, mode: "lines", line: { color: colour(series.colour), dash: DASHES[series.style], width: 1.6 } };
  }

  function level(run, one, ends) {
    const value = run.values[one.value];
    if (value === undefined || ends === null) return [];
    return [{ type: "scatter", mode: "lines", name: one.label, x: ends, y: [value, value], series: { ...one, style: "dotted" },
      line: { color: colour(one.colour), dash: "dot", width: 1.2 }, hovertemplate: "%{y:.4~g}" }];
  }

  const hasData = (trace) => trace.y.some((value) => !missing(value));

  function ofOneRun(plot, run) {
    const series = plot.series.map((one) => (one.style === "band" ? band(run, one) : line(plot, run, one))).filter(hasData);
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
      const trace = line(plot, run, series);
      if (plot.equal) fromItsStart(trace);
      trace.line = { color: colour(run.colour), dash: COMPARED_DASHES[i % COMPARED_DASHES.length], width: 1.5 };
      trace.name = `${run.name}: ${series.label}`;
      trace.hovertemplate = `%{x:.4~g}, %{y:.4~g}<extra>${run.name}: ${series.label}</extra>`;
      return trace;
    })).filter(hasData);
  }

  // Events: a line across the plot, and a mark at its top that shows the text.
  function marks(run) {
    const x = run.marks.flatMap((mark) => [mark.t_s, mark.t_s, null]), y = run.marks.flatMap(() => [0, 1, null]);
    const text = run.marks.map((mark) => `${mark.t_s.toFixed(1)} s  ${mark.node}: ${mark.text}`);
    const shared = { type: "scatter", yaxis: "y2", showlegend: false };
    return [
      { ...shared, mode: "lines", x, y, hoverinfo: "skip", line: { color: transparent(colour(MARK), 0.35), width: 1 } },
      { ...shared, mode: "markers", x: run.marks.map((mark) => mark.t_s), y: run.marks.map(() => 0.98), text,
        hovertemplate: "%{text}<extra>event</extra>", marker: { symbol: "triangle-down", size: 8, color: colour(MARK) } },
    ];
  }

  // --- axes ---------------------------------------------------------------------------------------------------------

  function extent(traces, axis) {
    let least = Infinity, most = -Infinity;
    for (const value of traces.flatMap((trace) => trace[axis])) {
      if (missing(value)) continue; // a gap
      if (value < least) least = value;
      if (value > most) most = value;
    }
    return least <= most ? [least, most] : null;
  }

  // Return the range of an axis with a margin, at least min_span long; values that are never negative begin at zero.
  function range(axis, traces, name) {
    const ends = extent(traces, name);
    if (ends === null) return [0, 1];
    let [least, most] = ends;
    const inOrder = () => (axis.downwards ? [most, least] : [least, most]);
    if (axis.rows && axis.rows.length) {
      [least, most] = [-0.5, axis.rows.length - 0.5];
      return inOrder();
    }
    if (axis.log) return [Math.log10(Math.max(least, 1e-9)) - 0.15, Math.log10(Math.max(most, 1e-9)) + 0.15];
    const lacking = Math.max(0, (axis.min_span || 1e-6) - (most - least)) / 2;
    const margin = (axis.time ? 0.01 : 0.05) * (most - least + 2 * lacking);
    const negative = least < 0 || axis.downwards || name === "x";
    least -= lacking + margin;
    most += lacking + margin;
    if (!negative && least < 0) [least, most] = [0, Math.max(most, axis.min_span || 0)];
    return inOrder();
  }

  function axisLayout(axis, traces, name) {
    const line = theme("--axis");
    const rows = axis.rows && axis.rows.length ? { tickvals: axis.rows.map((_, i) => i), ticktext: axis.rows } : {};
    return {
      title: { text: axis.label, standoff: 4, font: { size: letters(11) } }, range: range(axis, traces, name),
      type: axis.log ? "log" : "linear", gridcolor: theme("--grid"), zeroline: false, linecolor: line, showline: true,
      ticks: "outside", ticklen: 3, tickcolor: line, nticks: 6, automargin: true,
      ...(axis.log ? { dtick: 1, tickformat: "~g" } : {}), ...rows,
    };
  }

  // Return the common range of all time axes, so that simultaneous values are aligned.
  function times(runs) {
    const columns = runs.flatMap((run) => Object.values(run.tables)).map((table) => ({ x: table.t_s || [] }));
    return range({ time: true }, columns, "x");
  }

  // Return true if any run has data: before that a plot cannot say why it is empty.
  const begun = (runs) => runs.some((run) => Object.values(run.tables).some((table) => (table.t_s || []).length > 0));

  // View: {follow: around the vehicle, at_s: a moment that time plots mark, ranges: of the axes, in place of their own,
  // empty: the text without data, hides: a panel without data is not shown}.
  function layout(plot, traces, timeRange, view) {
    const around = view.follow ? traces.filter((trace) => plot.follow.includes(trace.series.table)) : [];
    const x = axisLayout(plot.x, around.length ? around : traces, "x");
    const y = axisLayout(plot.y, around.length ? around : traces, "y");
    if (view.ranges) [x.range, y.range] = view.ranges;
    const empty = traces.length === 0;
    const made = {
      margin: { l: letters(58), r: 8, t: 6, b: letters(42) }, showlegend: false, hovermode: "closest", uirevision: `${Boolean(view.follow)}`,
      font: { family: "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", size: letters(11), color: theme("--ink") },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: theme("--paper"),
      xaxis: plot.x.time ? { ...x, range: timeRange } : x, yaxis: plot.equal ? { ...y, scaleanchor: "x", scaleratio: 1 } : y,
      annotations: empty ? [{ text: view.empty, xref: "paper", yref: "paper", x: 0.5, y: 0.5, showarrow: false,
        font: { size: letters(12), color: theme("--quiet") } }] : [],
      shapes: plot.x.time && !missing(view.at_s) ? [{ type: "line", yref: "paper", y0: 0, y1: 1, x0: view.at_s, x1: view.at_s,
        line: { color: theme("--accent"), width: 2 } }] : [],
    };
    if (plot.x.time) made.yaxis2 = { overlaying: "y", range: [0, 1], visible: false, fixedrange: true };
    return made;
  }

  // Draw a plot of one or several runs in its panel.
  function draw(panel, plot, runs, timeRange, view = {}) {
    const several = runs.length > 1;
    const traces = several ? ofSeveral(plot, runs) : ofOneRun(plot, runs[0]);
    panel.section.hidden = Boolean(view.hides) && traces.length === 0 && begun(runs);
    if (panel.section.hidden) return Promise.resolve();
    const empty = begun(runs) ? plot.empty : NO_DATA;
    const made = layout(plot, traces, timeRange, { ...view, follow: panel.follow, empty });
    const events = plot.x.time && !several && runs[0].marks.length > 0;
    showLegend(panel.legend, several ? comparedChips(plot) : chips(plot, traces, events, runs[0]));
    const shown = events ? traces.concat(marks(runs[0])) : traces;
    return inTurn(panel.place, () => Plotly.react(panel.place, shown, { ...made, ...size(panel.place) }, CONFIG));
  }

  // Return the range of both axes of a plot over several runs, to draw each by itself on equal axes.
  function ranges(plot, runs) {
    const traces = runs.flatMap((run) => ofOneRun(plot, run));
    return [plot.x.time ? times(runs) : range(plot.x, traces, "x"), range(plot.y, traces, "y")];
  }

  // --- legend -------------------------------------------------------------------------------------------------------

  function chip(label, hex, style) {
    const item = element("li", ""), sample = element("span", "", `line ${style}`);
    sample.style.color = colour(hex);
    item.append(sample, label);
    return item;
  }

  // Return the entries of a legend: what is drawn, once each.
  function chips(plot, traces, events, run) {
    const drawn = new Map(traces.map(({ series }) => [series.label, [series.label, series.colour, series.style]]));
    const labels = new Set([...plot.series, ...plot.levels].map((one) => one.label).filter((label) => label && drawn.has(label)));
    const made = [...labels].map((label) => drawn.get(label));
    if (events) made.push(["event", MARK, "mark"]);
    if (plot.drifts && run.values.since_s !== undefined) made.push([`since t = ${run.values.since_s} s`, null, ""]);
    return made;
  }

  // With several runs a legend explains the dashes; one common legend explains the colours.
  function comparedChips(plot) {
    const compared = plot.series.filter((series) => series.compared);
    const styles = ["line", "dashed", "dotted"];
    const made = plot.equal ? [["each run from its own start", null, ""]] : [];
    return compared.length > 1 ? made.concat(compared.map((one, i) => [one.label, theme("--ink"), styles[i % 3]])) : made;
  }

  function showLegend(list, entries) {
    const key = JSON.stringify([entries, darkness.matches]);
    if (list.dataset.key === key) return;
    list.dataset.key = key;
    list.replaceChildren(...entries.map(([label, hex, style]) => (hex === null ? element("li", label) : chip(label, hex, style))));
  }

  // --- panels -------------------------------------------------------------------------------------------------------

  // Return name and cells of each column of a series: of a band both of its edges, not its outline.
  function columnsOf(plot, { series, x, y, edges, name: shown }) {
    const name = shown || `${series.table} ${series.x_high ? series.x : series.y}`;
    const columns = [[`${name} ${plot.x.label}`, edges ? edges.x : x], [`${name} ${plot.y.label}`, edges ? edges.y : y]];
    if (edges && edges.xHigh) columns.push([`${name}, other edge ${plot.x.label}`, edges.xHigh]);
    if (edges && edges.yHigh) columns.push([`${name}, other edge ${plot.y.label}`, edges.yHigh]);
    return columns;
  }

  function save(panel, plot, format) {
    const file = [document.title, plot.name, ...panel.of].join("-").replace(/[^\w.-]+/g, "-");
    if (format === "csv") {
      const columns = panel.place.data.filter((trace) => trace.series).flatMap((trace) => columnsOf(plot, trace));
      const rows = Math.max(0, ...columns.map(([, cells]) => cells.length));
      const lines = [columns.map(([name]) => `"${name}"`).join(",")];
      for (let i = 0; i < rows; i++) lines.push(columns.map(([, cells]) => cells[i] ?? "").join(","));
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }));
      link.download = `${file}.csv`;
      link.click();
      URL.revokeObjectURL(link.href);
      return;
    }
    const { data, layout: shown } = panel.place;
    const legend = { orientation: "h", yref: "container", y: 0, yanchor: "bottom" }; // below the plot: a long one would cover the title
    const figure = { data, layout: { ...shown, title: { text: [plot.title, ...panel.of].join(", "), font: { size: 14 } }, showlegend: true, legend,
      margin: { l: 60, r: 20, t: 50, b: 50 }, paper_bgcolor: theme("--paper") } };
    Plotly.downloadImage(figure, { format, filename: file, width: 900, height: plot.equal ? 900 : 500, scale: format === "png" ? 2 : 1 });
  }

  // Return the menu of a panel: what the plot shows, and files of it.
  function menu(panel, plot) {
    const made = element("details", "", "menu");
    const label = element("summary", "⋯");
    label.setAttribute("aria-label", `About "${plot.title}", and save it`);
    made.append(label);
    const content = element("div", "");
    if (plot.note) content.append(element("p", plot.note));
    for (const format of ["png", "svg", "csv"]) {
      const name = format.toUpperCase();
      content.append(button(name, () => save(panel, plot, format), { label: `Save "${plot.title}" as ${name}` }));
    }
    made.append(content);
    return made;
  }

  function followButton(panel, onChange) {
    const show = () => { made.textContent = panel.follow ? "whole track" : "follow"; };
    const made = button("", () => {
      panel.follow = !panel.follow;
      show();
      onChange();
    });
    show();
    return made;
  }

  // Return the size of a place; nothing while it is hidden.
  const size = (place) => (place.clientWidth && place.clientHeight ? { width: place.clientWidth, height: place.clientHeight } : {});

  // Draw at a place after what is drawn there now: of two drawings that overlap, plotly keeps the size or the colours of
  // the older one.
  function inTurn(place, drawing) {
    place.drawn = (place.drawn || Promise.resolve()).then(drawing, drawing);
    return place.drawn;
  }

  // Give what is drawn at a place the size that the place has now.
  function fit(place) {
    const { width, height } = size(place);
    if (!place.data || !width || (place.layout.width === width && place.layout.height === height)) return null;
    return Plotly.relayout(place, { width, height });
  }

  // Add a panel to `parent` and return it: {section, legend, place, follow, of}. A title that is not that of the plot
  // names the run that it shows, in files of the plot too.
  function panelOf(parent, plot, title, id) {
    const section = element("section", "", "panel");
    section.id = `panel-${id}`;
    const panel = { section, legend: element("ul", "", "legend"), place: element("div", "", "plot"), follow: false,
      of: title === plot.title ? [] : [title] };
    panel.place.id = `plot-${id}`;
    panel.place.setAttribute("role", "img");
    panel.place.setAttribute("aria-label", `Plot: ${title}, ${plot.y.label} over ${plot.x.label}`);
    panel.head = element("div", "", "head");
    panel.head.append(element("h3", title), menu(panel, plot));
    section.append(panel.head, panel.legend, panel.place);
    // A legend that needs another line leaves the plot less height.
    new ResizeObserver(() => inTurn(panel.place, () => fit(panel.place))).observe(panel.place);
    parent.append(section);
    return panel;
  }

  // Add a heading for each question and a panel for each plot to `parent`; return the panels by name.
  function frames(parent, plots, { follow = false, onChange = () => {} } = {}) {
    const panels = new Map(), grids = new Map();
    for (const plot of plots) {
      if (!grids.has(plot.group)) {
        const part = element("section", "", "part");
        grids.set(plot.group, element("div", "", "grid"));
        part.append(element("h2", plot.group), grids.get(plot.group));
        parent.append(part);
      }
      const panel = panelOf(grids.get(plot.group), plot, plot.title, plot.name);
      if (plot.follow.length) {
        panel.follow = follow;
        panel.head.lastChild.before(followButton(panel, onChange));
      }
      panels.set(plot.name, panel);
    }
    return panels;
  }

  // Set the colours of a dark background; call `redraw` when the reader's system changes.
  function useColours(dark, redraw) {
    darkColours = dark;
    darkness.addEventListener("change", redraw);
  }

  return { frames, panelOf, draw, chip, times, ranges, useColours, element, button };
})();
