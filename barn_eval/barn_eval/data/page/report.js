"use strict";

/* The report's table of trials and its view of one. Texts from files only ever become text nodes. */

const PAGE = 100;

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function dot(entry) {
  const made = element("span", { className: "dot" });
  made.style.background = entry.colour;
  return made;
}

const byId = (id) => document.getElementById(id);

class TrialTable {
  constructor(data, open) {
    Object.assign(this, { data, open, sorted: null, descending: false, first: 0 });
    this.outcome = data.columns.findIndex((column) => column.name === "outcome");
    this.texts = data.trials.map((trial) => `${trial.id} ${trial.name} ${trial.detail} ${trial.cells[this.outcome]}`.toLowerCase());
    const head = document.querySelector("#trials thead tr");
    data.columns.forEach((column, index) => {
      const button = element("button", { type: "button", textContent: column.unit ? `${column.title} [${column.unit}]` : column.title });
      button.addEventListener("click", () => this.sortBy(index));
      head.append(element("th", { className: column.digits === null ? "" : "number", scope: "col" }, button));
    });
    this.choices("filter-planner", data.entries.map((entry) => entry.label));
    this.choices("filter-outcome", [...new Set(data.trials.map((trial) => trial.cells[this.outcome]))].sort());
    for (const [id, event] of [["search", "input"], ["filter-planner", "change"], ["filter-outcome", "change"]]) {
      byId(id).addEventListener(event, () => { this.first = 0; this.draw(); });
    }
    byId("earlier").addEventListener("click", () => { this.first = Math.max(0, this.first - PAGE); this.draw(); });
    byId("later").addEventListener("click", () => { this.first += PAGE; this.draw(); });
    this.draw();
  }

  choices(id, names) {
    for (const name of names) byId(id).append(element("option", { value: name, textContent: name.replaceAll("_", " ") }));
  }

  sortBy(index) {
    this.descending = this.sorted === index && !this.descending;
    this.sorted = index;
    this.first = 0;
    document.querySelectorAll("#trials th").forEach((cell, at) => {
      if (at === index) cell.setAttribute("aria-sort", this.descending ? "descending" : "ascending"); else cell.removeAttribute("aria-sort");
      const button = cell.firstChild;
      button.textContent = button.textContent.replace(/ [▲▼]$/, "") + (at === index ? (this.descending ? " ▼" : " ▲") : "");
    });
    this.draw();
  }

  chosen() {
    const words = byId("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    const planner = byId("filter-planner").value, outcome = byId("filter-outcome").value;
    const { trials, entries } = this.data;
    const rows = trials.map((_, index) => index).filter((index) =>
      (!planner || entries[trials[index].entry].label === planner) &&
      (!outcome || trials[index].cells[this.outcome] === outcome) &&
      words.every((word) => this.texts[index].includes(word)));
    if (this.sorted === null) return rows;
    const sign = this.descending ? -1 : 1;
    const value = (index) => trials[index].cells[this.sorted];
    return rows.sort((a, b) => {
      const left = value(a), right = value(b);
      if (left === right) return a - b;
      if (left === null) return 1; // what is not known comes last, whichever way
      if (right === null) return -1;
      return sign * (typeof left === "string" ? left.localeCompare(right) : left - right);
    });
  }

  draw() {
    const rows = this.chosen();
    this.first = Math.min(this.first, Math.max(0, PAGE * Math.floor((rows.length - 1) / PAGE)));
    const last = Math.min(rows.length, this.first + PAGE);
    byId("count").textContent = rows.length ? `${this.first + 1} to ${last} of ${rows.length} trials` : "no such trial";
    byId("earlier").disabled = this.first === 0;
    byId("later").disabled = last >= rows.length;
    document.querySelector("#trials tbody").replaceChildren(...rows.slice(this.first, last).map((index) => this.row(index)));
  }

  row(index) {
    const trial = this.data.trials[index];
    const row = element("tr", { tabIndex: 0 });
    row.dataset.trial = trial.id;
    trial.cells.forEach((cell, at) => {
      const column = this.data.columns[at];
      const text = cell === null ? "-" : column.digits === null ? cell.replaceAll("_", " ") : cell.toFixed(column.digits);
      const made = element("td", { className: column.digits === null ? "" : "number", textContent: at ? text : "" });
      if (at === 0) {
        made.append(dot(this.data.entries[trial.entry]), cell);
      }
      row.append(made);
    });
    row.addEventListener("click", () => this.open(index));
    row.addEventListener("keydown", (event) => { if (event.key === "Enter") this.open(index); });
    return row;
  }
}

class TrialView {
  constructor(data) {
    this.data = data;
    this.dialog = byId("trial");
    this.charts = ["speed", "turn", "clearance"];
    byId("close").addEventListener("click", () => this.dialog.close());
    this.dialog.addEventListener("close", () => { if (this.player) this.player.pause(); });
    for (const name of this.charts) {
      const canvas = byId("trial-chart-" + name);
      const seek = (event) => { if (this.player && this.toTime) this.player.seek(this.toTime(event.offsetX)); };
      canvas.addEventListener("pointerdown", seek);
      canvas.addEventListener("pointermove", (event) => { if (event.buttons) seek(event); });
    }
    addEventListener("resize", () => this.redraw());
    onThemeChange(() => this.redraw());
  }

  async open(index) {
    const trial = this.data.trials[index], world = this.data.worlds[trial.checksum];
    this.opened = null;
    this.facts(trial);
    if (!this.dialog.open) this.dialog.showModal();
    const map = world ? await unpack(world.packed) : null;
    const track = trial.track ? await this.unpackTrack(trial.track) : null;
    this.world = world ? { ...world, cylinders: map.cylinders, path: map.path } : null;
    this.track = track;
    byId("trial-player").hidden = !track;
    byId("trial-scene").hidden = !track && !world;
    this.scene = new Scene(byId("trial-scene"), world ? this.room(world.bounds) : track ? around(track) : [0, 0, 1, 1]);
    if (track) this.play(track); else this.draw(0);
    this.opened = trial.id;
    document.body.dataset.opened = trial.id;
  }

  room([left, below, right, above]) { return [left, below, right, above + 0.8]; }

  async unpackTrack(packed) {
    const { samples, contact } = await unpack(packed);
    const count = samples.length / this.data.channels.length, track = { contact };
    this.data.channels.forEach((name, channel) => {
      const values = new Float64Array(count), whole = new Int16Array(1);
      for (let i = 0; i < count; i++) {
        whole[0] += samples[channel * count + i]; // differences, which wrap around as they did when they were made
        values[i] = whole[0] === this.data.no_number ? NaN : whole[0] * packed.steps[channel];
      }
      track[name] = values;
    });
    return track;
  }

  play(track) {
    if (this.player) this.player.pause();
    const controls = {};
    for (const name of ["play", "scrub", "speed", "clock"]) {
      const before = byId("trial-" + name), fresh = before.cloneNode(true); // without the listeners of the last trial
      if (name === "speed") fresh.value = before.value;
      before.replaceWith(fresh);
      controls[name] = fresh;
    }
    this.contacts = spans(track.time, track.contact);
    this.player = new Player(track.time[track.time.length - 1], controls, (time) => this.draw(time));
    this.player.seek(this.player.end);
  }

  redraw() { if (this.dialog.open && this.scene) this.draw(this.player && this.track ? this.player.time : 0); }

  draw(time) {
    const { scene, world, track } = this;
    scene.begin();
    if (world) {
      for (let i = 0; i < world.cylinders.length; i += 2) scene.disc(world.cylinders[i] * world.step, world.cylinders[i + 1] * world.step, world.radius, "obstacle", true);
      scene.line(Array.from(world.path, (value) => value * world.step), "candidate", 1.4, [5, 4]);
    }
    if (track) {
      const at = Math.max(0, indexAt(track.time, time)), points = [];
      for (let i = 0; i < track.x.length; i++) points.push(track.x[i], track.y[i]);
      scene.context.globalAlpha = 0.3;
      scene.line(points, "trail", 2);
      scene.context.globalAlpha = 1;
      scene.line(points.slice(0, 2 * at + 2), "trail", 2.4);
      scene.robot(track.x[at], track.y[at], track.yaw[at], this.data.extent, track.contact[at]);
    }
    scene.end();
    if (track) this.drawCharts(time);
  }

  drawCharts(time) {
    const { track } = this;
    const pair = (driven, commanded) => [
      { name: "driven", colour: "trail", values: track[driven] },
      { name: "commanded", colour: "scan", values: track[commanded], dash: [5, 3] },
    ];
    const options = { cursor: time, marks: this.contacts };
    drawChart(byId("trial-chart-speed"), track.time, pair("speed", "command_speed"), { ...options, title: "forward speed", unit: "m/s" });
    drawChart(byId("trial-chart-turn"), track.time, pair("turn", "command_turn"), { ...options, title: "yaw rate", unit: "rad/s" });
    this.toTime = drawChart(byId("trial-chart-clearance"), track.time, [{ name: "clearance", colour: "plan", values: track.clearance }],
      { ...options, title: "clearance to the obstacles as they stood at the start", unit: "m" });
  }

  facts(trial) {
    const { columns, entries } = this.data;
    const outcome = trial.cells[columns.findIndex((column) => column.name === "outcome")];
    byId("trial-title").replaceChildren(dot(entries[trial.entry]), trial.id);
    byId("trial-ending").textContent = `${outcome.replaceAll("_", " ")}${trial.detail ? ": " + trial.detail : ""} (${trial.name})`;
    const notes = [trial.problem, trial.track ? trial.track.note : ""].filter(Boolean);
    byId("trial-problem").hidden = !notes.length;
    byId("trial-problem").textContent = notes.join("; ");
    const rows = columns.map((column, at) => {
      const cell = trial.cells[at];
      return [column.title, cell === null ? "none" : column.digits === null ? cell : `${cell.toFixed(column.digits)} ${column.unit}`];
    });
    rows.push(["seeds", `campaign ${trial.seeds[0]}, simulator ${trial.seeds[1]}, planner ${trial.seeds[2]}`]);
    rows.push(["folder", entries[trial.entry].folder]);
    if (trial.bag) rows.push(["see it again", `barn replay ${trial.bag}`]);
    byId("trial-facts").replaceChildren(...rows.flatMap(([name, value]) => [element("dt", { textContent: name }), element("dd", { textContent: value })]));
  }
}

function around(track) {
  const [left, right] = minmax(Array.from(track.x)), [below, above] = minmax(Array.from(track.y));
  return [left - 1, below - 1, right + 1, above + 1];
}

(() => {
  const data = JSON.parse(byId("data").textContent);
  const view = new TrialView(data);
  const show = (index) => view.open(index).catch((error) => {
    byId("trial-problem").hidden = false;
    byId("trial-problem").textContent = `It cannot be drawn: ${error.message}.`;
  });
  window.report = { data, view, table: new TrialTable(data, show) };
  document.body.dataset.ready = "yes";
})();
