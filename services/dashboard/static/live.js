// Live page: stores the data of the stream, draws one plot after the other, sends the commands of the buttons.
"use strict";
(() => {
  const AGAIN_MS = 1000; // between two attempts to connect
  const BEAT_MS = 1000; // between two heartbeats of the operator
  const SILENT_MS = 3000; // without a text the page says "no data"
  const DRAW_MS = 50; // least pause between two plots
  const PAUSES = 2; // pause after a plot, in times that it took: drawing takes a third of a core at most
  const UNSEEN_ROUNDS = 8; // plots outside the window are drawn in one of so many rounds
  const MAX_MOMENTS = 600; // states to look back at; with twice as many, every second one is dropped
  const SPEEDS = [0.5, 1, 2, 5, 10, 20];
  const MAX_AGE_S = { estimate: 0.5, plan: 1.0, actuators: 1.0 }; // vehicle seconds
  const SHOWN_AFTER_S = 0.15; // wall time from a message to its text here: the period of the stream, and the way
  const RESTARTED = ["estimator", "controller", "recorder"]; // a run continues without them for a short time

  const { element, button } = Plots;
  const token = location.hash.slice(1);
  const byId = (id) => document.getElementById(id);
  const run = { name: "", colour: null, tables: {}, values: {}, marks: [] };
  const rows = new Map(); // of the processes, by name
  let about = {}, plots = [], panels = new Map(), status = null, socket = null, receivedAt = 0, beatAt = 0, number = 0;
  let dirty = false, next = 0, round = 0;
  let asking = false; // for the report
  let drawn = false; // every plot, once
  let moments = [], stride = 1, ticks = 0, past = null; // states to look back at; the one that is shown, null: now
  const seen = new Set(); // plots in the window

  // --- the stream ---------------------------------------------------------------------------------------------------

  function connect() {
    socket = new WebSocket(`ws://${location.host}/stream`);
    socket.onmessage = (event) => receive(JSON.parse(event.data));
    socket.onclose = () => {
      if (status) controls();
      if (ended() || failure()) {
        show(failure() ? "lost" : "", failure() || "finished");
        return;
      }
      show("lost", "not connected; trying again");
      setTimeout(connect, AGAIN_MS);
    };
  }

  function receive(text) {
    receivedAt = Date.now();
    beat();
    if (text.kind === "hello") hello(text);
    else if (text.kind === "reply") showReply(text.text, text.done);
    else update(text);
  }

  function hello(text) {
    about = text.about;
    if (panels.size > 0) return; // connected again
    plots = text.plots;
    const redraw = () => { dirty = true; };
    Plots.useColours(text.dark, () => {
      round = UNSEEN_ROUNDS - 1; // the next round draws plots outside the window too
      redraw();
    });
    panels = Plots.frames(byId("plots"), plots, { follow: true, onChange: redraw });
    const watch = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) seen[isIntersecting ? "add" : "delete"](target);
      redraw();
    });
    for (const panel of panels.values()) watch.observe(panel.section);
  }

  function update(text) {
    if (text.kind === "whole") {
      run.tables = {};
      run.marks = [];
      byId("events").replaceChildren();
      byId("processes").replaceChildren();
      rows.clear();
      if (status !== null && text.run !== status.run) moments = [];
    }
    for (const [name, columns] of Object.entries(text.rows)) {
      const old = text.replaced.includes(name) ? {} : run.tables[name] || {};
      run.tables[name] = mapped(columns, (cells, column) => (old[column] || []).concat(cells));
    }
    Object.assign(run.tables, text.tables);
    run.values = text.values;
    run.marks = run.marks.concat(text.marks);
    byId("events").prepend(...text.marks.map(eventRow).reverse());
    status = text.status;
    keep({ status, tables: text.tables });
    if (past === null) showStatus(status);
    showName();
    controls();
    dirty = true;
  }

  const mapped = (columns, f) => Object.fromEntries(Object.entries(columns).map(([name, cells]) => [name, f(cells, name)]));

  // --- looking back -------------------------------------------------------------------------------------------------

  function keep(moment) {
    const t_s = moment.status.t_s;
    const last = moments.length ? moments[moments.length - 1].status.t_s : -Infinity;
    if (t_s === null || t_s <= last || ticks++ % stride !== 0) return;
    moments.push(moment);
    if (moments.length >= 2 * MAX_MOMENTS) {
      moments = moments.filter((_, i) => i % 2 === 0);
      stride *= 2;
    }
    const slider = byId("moment");
    slider.disabled = moments.length < 2;
    slider.min = moments[0].status.t_s;
    slider.max = t_s;
    if (past === null) slider.value = t_s;
  }

  function lookBack(t_s) {
    past = t_s === null ? null : moments.findLast((moment) => moment.status.t_s <= t_s) || moments[0];
    byId("at").textContent = past === null ? "now" : `t = ${past.status.t_s.toFixed(1)} s`;
    byId("now").disabled = past === null;
    if (past === null) byId("moment").value = byId("moment").max;
    showStatus((past || { status }).status);
    dirty = true;
  }

  // Return the run as it was at the moment that is shown: newest state of then, tracks until then.
  function shown(plot) {
    if (past === null) return run;
    const tables = { ...run.tables, ...past.tables };
    if (!plot.x.time) {
      for (const [name, columns] of Object.entries(tables)) {
        const end = (columns.t_s || []).findIndex((t) => t > past.status.t_s);
        if (end >= 0) tables[name] = mapped(columns, (cells) => cells.slice(0, end));
      }
    }
    return { ...run, tables };
  }

  // --- display ------------------------------------------------------------------------------------------------------

  // Draw one plot at a time, so that the page stays responsive; those outside the window less often.
  async function draw() {
    const began_ms = performance.now();
    const idle = plots.length === 0 || document.hidden || (!dirty && next === 0);
    if (!idle) {
      if (next === 0) {
        dirty = false;
        round += 1;
      }
      const everything = !drawn || ended() || round % UNSEEN_ROUNDS === 0;
      const isSeen = ({ section }) => section.hidden || seen.has(section);
      while (next < plots.length && !everything && !isSeen(panels.get(plots[next].name))) next += 1;
      if (next < plots.length) {
        const plot = plots[next];
        const view = { at_s: past && past.status.t_s, hides: status?.simulated === false };
        await Plots.draw(panels.get(plot.name), plot, [shown(plot)], Plots.times([run]), view).catch(console.error);
      }
      next += 1;
      if (next >= plots.length) {
        next = 0;
        drawn = drawn || post("drawn"); // the clock of a run waits for it
      }
    }
    setTimeout(draw, Math.max(DRAW_MS, drawn ? PAUSES * (performance.now() - began_ms) : 0));
  }

  // Return true if the server could be told.
  function post(what, more) {
    if (socket.readyState !== WebSocket.OPEN) return false;
    socket.send(JSON.stringify({ number: 0, token, button: what, ...more }));
    return true;
  }

  function show(state, text) {
    const link = byId("link");
    link.className = `state ${state}`;
    link.textContent = text;
  }

  function showName() {
    const name = about.name || status.name || about.bus;
    if (byId("name").textContent === name || !name) return;
    byId("name").textContent = name;
    document.title = `${name} · ltv-mpc`;
  }

  // Return "running at 10×", or "running at 3.1×, 10× requested" on a machine that cannot do more.
  function clockText(now) {
    if (now.clock === "own") return "its own";
    if (finished(now)) return "finished";
    if (now.clock !== "running") return now.clock;
    const { speed, requested_speed: asked } = now;
    return speed === asked ? `running at ${asked}×` : `running at ${Number(speed.toPrecision(3))}×, ${asked}× requested`;
  }

  const figure = (value, digits, unit) => (value === null ? "–" : `${value.toFixed(digits)} ${unit}`);

  // Return the fact about the fence: what the newest plan keeps, and the zones and margins that the hull is in.
  function fenceFacts(fence) {
    if (!fence || fence.clearance_m === null) return [];
    const parts = [`plan keeps ${figure(fence.clearance_m, 2, "m")} from ${fence.nearest}`];
    if (fence.inside.length) parts.push(`the hull is in ${fence.inside.join(", ")}`);
    else if (fence.in_margin.length) parts.push(`the hull is in the margin of ${fence.in_margin.join(", ")}`);
    if (fence.time_to_zone_ns) parts.push(`in a zone or obstacle in ${figure(fence.time_to_zone_ns / 1e9, 0, "s")}`);
    return [["fence", parts.join("; "), parts.length > 1 ? "bad" : "good"]];
  }

  function showStatus(now) {
    if (now === null) return;
    const degrees = now.heading_rad === null ? null : (((now.heading_rad * 180) / Math.PI) % 360 + 360) % 360;
    const { plan, controller } = now; // empty while there is none
    const since = run.values.in_places === undefined ? ` since t = ${run.values.since_s ?? 0} s` : "";
    const lasts = now.t_s !== null && now.health_s !== null ? `, ${figure(Math.max(now.t_s - now.health_s, 0), 0, "s")}` : "";
    const entries = [
      ["health", plan.health_why ? `${plan.health}: ${plan.health_why}${lasts}` : plan.health || "–", plan.health && (plan.health === "nominal" ? "good" : "bad")],
      ["command authority", plan.authority || "–"],
      ["plan", plan.why ? `${plan.origin}: ${plan.why}` : plan.origin || "–"],
      ...fenceFacts(plan.fence),
      ["time", figure(now.t_s, 1, "s")],
      ["estimate from the reference", figure(now.error_m, 3, "m")],
      ...(now.simulated ? [["vehicle from the reference", figure(now.true_error_m, 3, "m") + since]] : []),
      ["depth", figure(now.depth_m, 1, "m")],
      ["heading", degrees === null ? "–" : `${degrees.toFixed(0)}°`],
      ["clock", clockText(now)],
      ...([undefined, "", "default"].includes(controller.source) ? [] : [["estimates from", controller.source]]),
      ...((controller.progress ?? null) === null ? [] : [["progress", `${(100 * controller.progress).toFixed(0)} %`]]),
      ...(controller.arrived ? [["end of the reference", "arrived"]] : []),
    ];
    byId("facts").replaceChildren(...entries.map(([name, value, mood]) => {
      const fact = element("div", "");
      fact.append(element("dt", name), element("dd", value, mood));
      return fact;
    }));
    const known = rows.size;
    now.processes.forEach(showProcess);
    if (rows.size > known) byId("processes").append(...now.processes.map((one) => rows.get(one.name)));
    byId("ages").replaceChildren(element("span", "age of last message:"), ...ages(now));
  }

  // Of a simulation: its processes have published their last status.
  const finished = (now) => now.processes.some((one) => one.name === "plant" && one.state === "finished");
  const failure = () => (status?.preparation.startsWith("failed: ") ? status.preparation : "");
  const ended = () => status !== null && finished(status);

  function showEnd() {
    byId("finished").hidden = !ended();
    if (!ended() || byId("report").hasChildNodes()) return;
    const report = about.report ? ["Report: ", element("code", about.report)] : ["The report is in the run's folder."];
    byId("report").append(...report);
    if (about.again) byId("again").append("Run it again: ", ...copied(about.again));
  }

  // Return a command with a button that copies it. Where the browser refuses, because the page comes from another host
  // without https, the button selects the command instead.
  function copied(text) {
    const command = element("code", text), result = element("output", "");
    const copy = button("Copy", async () => {
      try {
        await navigator.clipboard.writeText(text);
        result.textContent = "copied";
      } catch {
        getSelection().selectAllChildren(command);
        result.textContent = "selected: copy it with Ctrl+C";
      }
    }, { label: "Copy the command" });
    return [command, " ", copy, result];
  }

  // The server ends when each page has the report, so the link leads to a copy that this page keeps.
  async function takeReport() {
    if (!about.report || asking || byId("report").querySelector("a")) return;
    asking = true;
    const reply = await fetch("/report").catch(() => null); // null: the server has ended
    if (reply && reply.status === 200) {
      const link = element("a", "Open the report");
      link.href = URL.createObjectURL(new Blob([await reply.blob()], { type: "text/html" }));
      link.target = "_blank";
      byId("report").firstChild.replaceWith(link, ": ");
      post("has report"); // the end of a run waits for it
    }
    asking = false;
  }

  function row(...cells) {
    const made = document.createElement("tr");
    made.append(...cells);
    return made;
  }

  const eventRow = (mark) => row(element("td", mark.t_s.toFixed(1), "number"), element("td", mark.node), element("td", mark.text));

  // Keep the row of a process, so that its button can be pressed.
  function processRow(name) {
    const made = row(element("td", name), element("td", ""), element("td", "", "number"), element("td", ""), element("td", ""));
    if (token && RESTARTED.includes(name)) made.lastChild.append(killer(name));
    rows.set(name, made);
    return made;
  }

  function showProcess(process) {
    const silent = process.silent_s > 2 && process.state !== "finished";
    const [, state, step, lost, last] = (rows.get(process.name) || processRow(process.name)).children;
    state.textContent = silent ? `silent for ${process.silent_s.toFixed(0)} s` : process.state;
    state.className = silent ? "bad" : "";
    state.title = `${process.state}; ${process.steps} steps; last status ${process.silent_s.toFixed(1)} s ago`;
    step.textContent = process.step_us ? process.step_us.toFixed(0) : "–"; // its last status has no step
    lost.textContent = String(process.dropped + process.rejected);
    lost.className = lost.textContent === "0" ? "number" : "number bad";
    last.hidden = !status.simulated || ended() || process.state === "finished";
  }

  function killer(node) {
    const made = button("kill", () => send("kill", { node }));
    made.dataset.kill = node;
    made.title = `End the ${node}'s process without warning; the supervisor starts another`;
    return made;
  }

  function ages(now) {
    return Object.entries(now.ages_s).map(([name, age]) => {
      const late = age !== null && MAX_AGE_S[name] !== undefined && age > MAX_AGE_S[name] + SHOWN_AFTER_S * now.speed;
      return element("span", `${name} ${age === null ? "–" : `${age.toFixed(2)} s`}`, late ? "late" : "");
    });
  }

  // --- commands -----------------------------------------------------------------------------------------------------

  function controls() {
    const live = token !== "" && socket.readyState === WebSocket.OPEN && rows.size > 0 && !ended();
    for (const control of document.querySelectorAll("#buttons button, #buttons select")) control.disabled = !live;
    document.querySelector(".simulated").hidden = !status.simulated;
    const paused = status.clock === "paused" && !ended();
    byId("pause").textContent = paused ? "Resume" : "Pause";
    byId("pause").dataset.button = paused ? "resume" : "pause";
    const speed = byId("speed");
    if (document.activeElement !== speed) speed.value = String(status.requested_speed);
    if (!token) showReply("read-only: open the printed address, which carries the token", false);
  }

  function showReply(text, done) {
    const reply = byId("reply");
    reply.textContent = text;
    reply.className = done ? "" : "bad";
  }

  function send(what, more) {
    number += 1;
    if (post(what, { number, ...more })) showReply(`${what} …`, true);
  }

  // Tell the vehicle that an operator is there. The stream drives it: browsers slow the timers of hidden pages.
  function beat() {
    if (token && receivedAt - beatAt >= BEAT_MS && post("heartbeat")) beatAt = receivedAt;
  }

  byId("buttons").addEventListener("click", (event) => {
    const pressed = event.target.closest("button");
    if (pressed) send(pressed.dataset.button, {});
  });
  byId("moment").addEventListener("input", (event) => lookBack(Number(event.target.value)));
  byId("now").addEventListener("click", () => lookBack(null));
  byId("speed").append(...SPEEDS.map((speed) => new Option(`${speed}×`, speed)));
  byId("speed").addEventListener("change", (event) => {
    send("speed", { speed: Number(event.target.value) });
    event.target.blur();
  });

  setInterval(() => {
    showEnd();
    if (socket.readyState !== WebSocket.OPEN) return;
    if (ended()) takeReport();
    if (failure()) show("lost", failure());
    else if (Date.now() - receivedAt > SILENT_MS) show("lost", "no data");
    else if (status && status.clock === "silent") show("", status.preparation || "connected; no data yet");
    else if (ended()) show("", "finished");
    else show("live", "live");
  }, 500);
  connect();
  draw();
})();
