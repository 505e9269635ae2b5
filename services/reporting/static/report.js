// The report: every plot once, from the data in the page itself; of several runs, one plot of each beside the others.
"use strict";
(() => {
  const { plots, runs, dark } = JSON.parse(document.getElementById("data").textContent);
  const several = runs.length > 1;
  const parent = document.getElementById("plots");
  const times = Plots.times(runs);
  const together = several ? plots.filter((plot) => plot.series.some((series) => series.compared)) : plots;
  const panels = Plots.frames(parent, together, { onChange: draw });

  function draw() {
    for (const plot of together) Plots.draw(panels.get(plot.name), plot, runs, times);
    if (several) document.getElementById("runs").replaceChildren(...runs.map((run) => Plots.chip(run.name, run.colour, "line")));
  }

  // Small multiples: the chosen plot of each run by itself, all on equal axes.
  function sideBySide() {
    const part = Plots.element("section", "", "part");
    const choice = document.createElement("select");
    choice.id = "multiples-of";
    choice.append(...plots.map((plot) => new Option(plot.title, plot.name)));
    const label = Plots.element("label", "Each run by itself: ");
    label.append(choice);
    const head = Plots.element("h2", "");
    head.append(label);
    const grid = Plots.element("div", "", "grid multiples");
    part.append(head, grid);
    parent.after(part);
    const show = () => {
      const plot = plots.find((one) => one.name === choice.value);
      const ranges = Plots.ranges(plot, runs);
      grid.replaceChildren();
      runs.forEach((run, i) => {
        const panel = Plots.panelOf(grid, plot, run.name, `${plot.name}-${i}`);
        Plots.draw(panel, plot, [run], ranges[0], { ranges });
      });
    };
    choice.addEventListener("change", show);
    show();
  }

  // Return the value of a cell: a number if it is one, null if there is none.
  function cell(td) {
    const text = td ? td.textContent : "";
    if (text === "" || text === "-") return null;
    return Number.isNaN(Number(text)) ? text : Number(text);
  }

  // A press on a heading sorts the table by its column, up and then down.
  function sortable(table) {
    const heads = [...table.querySelectorAll("th")];
    heads.forEach((head, column) => {
      if (!head.textContent) return;
      head.replaceChildren(Plots.button(head.textContent, () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        heads.forEach((one) => one.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const body = table.tBodies[table.tBodies.length - 1];
        const key = (row) => cell(row.cells[column]);
        const compare = (a, b) => (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b)));
        const sorted = [...body.rows].sort((a, b) => (down ? -1 : 1) * compare(key(a), key(b)));
        // A row without a value stays at the end in both orders.
        body.append(...sorted.filter((row) => key(row) !== null), ...sorted.filter((row) => key(row) === null));
      }, { kind: "sort" }));
    });
  }

  Plots.useColours(dark, draw);
  draw();
  if (several) sideBySide();
  document.querySelectorAll("table.sortable").forEach(sortable);
})();
