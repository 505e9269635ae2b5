// The report: every plot once, from the data in the page itself.
"use strict";
(() => {
  const { plots, runs } = JSON.parse(document.getElementById("data").textContent);
  const several = runs.length > 1;
  const places = Plots.frames(document.getElementById("plots"), plots, several);
  const heading = several
    ? runs.map((run) => Plots.chip(run.name, run.colour, "line"))
    : [Plots.chip("event", Plots.MARK, "mark")];
  document.getElementById("runs").append(...heading);
  const times = Plots.times(runs);
  for (const plot of plots) Plots.draw(places.get(plot.name), plot, runs, times);
})();
