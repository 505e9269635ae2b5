// Live page: stores the data of the stream, draws one plot after the other, sends the commands of the buttons.
"use strict";
(() => {
  const AGAIN_MS = 1000; // between two attempts to connect
  const BEAT_MS = 1000; // between two heartbeats of the operator
  const SILENT_MS = 3000; // without a text the page says "no data"
  const DRAW_MS = 60; // between two plots: all seven in less than 0.5 s, with idle time between them
  const SPEEDS = [0.5, 1, 2, 5, 10, 20];
  const MAX_AGE_S = { estimate: 0.5, plan: 1.0, actuators: 1.0 }; // vehicle seconds
  const RESTARTED = ["estimator", "controller", "recorder"]; // a run continues without them for a short time

  const token = location.hash.slice(1);
  const byId = (id) => document.getElementById(id);
  const run = { name: "", colour: null, tables: {}, values: {}, marks: [] };
  const rows = new Map(); // of the processes, by name
  let plots = [], places = new Map(), status = null, socket = null, receivedAt = 0, beatAt = 0, number = 0, dirty = false, next = 0;
  let drawn = false; // every plot, once

  // --- the stream ---------------------------------------------------------------------------------------------------

  function connect() {
    socket = new WebSocket(`ws://${location.host}/stream`);
    socket.onmessage = (event) => receive(JSON.parse(event.data));
    socket.onclose = () => {
      if (status) controls();
      if (ended()) {
        show("", "finished: the report is in the run's folder");
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
    run.name = text.name;
    byId("name").textContent = text.name;
    document.title = `${text.name} · ltv-mpc`;
    if (places.size > 0) return; // connected again
    plots = text.plots;
    places = Plots.frames(byId("plots"), plots, false);
  }

  function update(text) {
    if (text.kind === "whole") {
      run.tables = {};
      run.marks = [];
      byId("events").replaceChildren();
      byId("processes").replaceChildren();
      rows.clear();
    }
    for (const [name, columns] of Object.entries(text.rows)) {
      const old = text.replaced.includes(name) ? undefined : run.tables[name];
      run.tables[name] = old ? joined(old, columns) : columns;
    }
    Object.assign(run.tables, text.tables);
    run.values = text.values;
    run.marks = run.marks.concat(text.marks);
    byId("events").prepend(...text.marks.map(eventRow).reverse());
    status = text.status;
    showStatus();
    dirty = true;
  }

  function joined(old, columns) {
    const all = {};
    for (const name of Object.keys(columns)) all[name] = old[name].concat(columns[name]);
    return all;
  }

  // --- display ------------------------------------------------------------------------------------------------------

  // Draw one plot at a time, so that the page stays responsive.
  function draw() {
    const idle = plots.length === 0 || document.hidden || (!dirty && next === 0);
    if (!idle) {
      if (next === 0) dirty = false;
      const plot = plots[next];
      next = (next + 1) % plots.length;
      Plots.draw(places.get(plot.name), plot, [run], Plots.times([run]));
      if (next === 0 && !drawn) reportDrawn();
    }
    setTimeout(draw, DRAW_MS);
  }

  // The clock of a run waits for it.
  function reportDrawn() {
    if (socket.readyState !== WebSocket.OPEN) return;
    drawn = true;
    socket.send(JSON.stringify({ number: 0, token, button: "drawn" }));
  }

  function show(state, text) {
    const link = byId("link");
    link.className = `state ${state}`;
    link.textContent = text;
  }

  /** "10×", or "3.1× of 10×" on a machine that cannot do more. */
  const times = ({ speed, requested_speed: asked }) =>
    (speed === asked ? `${asked}×` : `${Number(speed.toPrecision(3))}× of ${asked}×`);

  const number_ = (value, digits) => (value === null ? "–" : value.toFixed(digits));

  function showStatus() {
    const degrees = status.heading_rad === null ? null : (((status.heading_rad * 180) / Math.PI) % 360 + 360) % 360;
    const rows = [
      ["t", `${number_(status.t_s, 1)} s`],
      ["clock", status.clock === "own" ? "its own" : `${status.clock}, ${times(status)}`],
      ["command authority", status.authority || "–"],
      ["health", status.health_why ? `${status.health}: ${status.health_why}` : status.health || "–"],
      ["estimates from", status.source || "–"],
      ["plan", status.origin || "–"],
      ["depth", `${number_(status.depth_m, 1)} m`],
      ["heading", `${number_(degrees, 0)}°`],
      ["from reference", `${number_(status.error_m, 2)} m`],
    ];
    if (status.progress !== null) rows.push(["done", `${(100 * status.progress).toFixed(0)} %`]);
    byId("figures").replaceChildren(...rows.map(([name, value]) => {
      const row = document.createElement("div");
      row.append(element("dt", name), element("dd", value));
      return row;
    }));
    status.processes.forEach(showProcess);
    byId("ages").replaceChildren(...ages());
    controls();
  }

  // Of a simulation: its processes have published their last status.
  const ended = () => status !== null && status.processes.some((one) => one.name === "plant" && one.state === "finished");

  function element(tag, text, name) {
    const made = document.createElement(tag);
    made.textContent = text;
    if (name) made.className = name;
    return made;
  }

  function eventRow(mark) {
    const row = document.createElement("tr");
    row.append(element("td", mark.t_s.toFixed(1), "number"), element("td", mark.node), element("td", mark.text));
    return row;
  }

  // Keep the row of a process, so that its button can be pressed.
  function processRow(name) {
    const row = document.createElement("tr");
    row.append(element("td", name), element("td", ""), element("td", "", "number"), element("td", ""),
      document.createElement("td"));
    if (token && RESTARTED.includes(name)) row.lastChild.append(killer(name));
    byId("processes").append(row);
    rows.set(name, row);
    return row;
  }

  function showProcess(process) {
    const row = rows.get(process.name) || processRow(process.name);
    const silent = process.silent_s > 2 && process.state !== "finished";
    const [, state, step, lost, last] = row.children;
    state.textContent = silent ? `silent for ${process.silent_s.toFixed(0)} s` : process.state;
    state.className = silent ? "bad" : "";
    state.title = `${process.state}; ${process.steps} steps; last status ${process.silent_s.toFixed(1)} s ago`;
    step.textContent = process.step_us.toFixed(0);
    lost.textContent = String(process.dropped + process.rejected);
    lost.className = lost.textContent === "0" ? "number" : "number bad";
    last.hidden = !status.simulated || process.state === "finished";
  }

  function killer(node) {
    const button = element("button", "kill", "small");
    button.type = "button";
    button.dataset.kill = node;
    button.title = `End the ${node}'s process without warning; the launcher starts another`;
    return button;
  }

  function ages() {
    return Object.entries(status.ages_s).map(([name, age]) => {
      const late = age !== null && MAX_AGE_S[name] !== undefined && age > MAX_AGE_S[name];
      return element("span", `${name} ${age === null ? "–" : `${age.toFixed(2)} s`}`, late ? "late" : "");
    });
  }

  // --- commands -----------------------------------------------------------------------------------------------------

  function controls() {
    const live = token !== "" && socket.readyState === WebSocket.OPEN && rows.size > 0 && !ended();
    for (const control of document.querySelectorAll("#buttons button, #buttons select")) control.disabled = !live;
    document.querySelector(".simulated").hidden = !status.simulated;
    const paused = status.clock === "paused";
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

  function send(button, more) {
    if (socket.readyState !== WebSocket.OPEN) return;
    number += 1;
    socket.send(JSON.stringify({ number, token, button, ...more }));
    showReply(`${button} …`, true);
  }

  // Tell the vehicle that an operator is there. The stream drives it: browsers slow the timers of hidden pages.
  function beat() {
    if (!token || socket.readyState !== WebSocket.OPEN || receivedAt - beatAt < BEAT_MS) return;
    beatAt = receivedAt;
    socket.send(JSON.stringify({ number: 0, token, button: "heartbeat" }));
  }

  byId("buttons").addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (button) send(button.dataset.button, {});
  });
  byId("processes").addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (button) send("kill", { node: button.dataset.kill });
  });
  byId("speed").append(...SPEEDS.map((speed) => new Option(`${speed}×`, speed)));
  byId("speed").addEventListener("change", (event) => {
    send("speed", { speed: Number(event.target.value) });
    event.target.blur();
  });

  setInterval(() => {
    if (socket.readyState !== WebSocket.OPEN) return;
    if (Date.now() - receivedAt > SILENT_MS) show("lost", "no data");
    else if (status && status.clock === "silent") show("", status.preparation || "connected; no data yet");
    else if (ended()) show("", "the run has ended");
    else show("live", "live");
  }, 500);
  connect();
  draw();
})();
