/* The report's table of trials and its view of one. Texts from files only ever become text nodes. */

const PAGE = 100;
const FILTERS = ["search", "filter-planner", "filter-outcome", "filter-band", "filter-from", "filter-to"];

function dot(entry) {
  const made = element("span", { className: "dot" });
  made.style.background = `var(--c-${entry.color.slice(1).toLowerCase()}, ${entry.color})`;
  return made;
}

class TrialTable {
  constructor(data, open, changed) {
    Object.assign(this, { data, open, changed, sorted: null, descending: false, first: 0 });
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
    this.world = data.columns.findIndex((column) => column.name === "world");
    this.bands = new Map(data.bands.map((band) => [band.name, new Set(band.worlds)]));
    for (const { name, worlds } of data.bands) byId("filter-band").append(element("option", { value: name, textContent: `${/\d/.test(name) ? `band ${name}` : `${name} worlds`} (${worlds.length})` }));
    byId("filter-band").hidden = !this.bands.size;
    byId("filters").open = matchMedia("(min-width: 641px)").matches;
    for (const id of FILTERS) byId(id).addEventListener(byId(id).tagName === "SELECT" ? "change" : "input", () => { this.first = 0; this.draw(); });
    byId("filter-reset").addEventListener("click", () => { for (const id of FILTERS) byId(id).value = ""; this.first = 0; this.draw(); });
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
    const band = this.bands.get(byId("filter-band").value);
    const from = Number(byId("filter-from").value || 0), to = Number(byId("filter-to").value || Infinity);
    const { trials, entries } = this.data;
    const rows = trials.map((_, index) => index).filter((index) =>
      (!planner || entries[trials[index].entry].label === planner) &&
      (!outcome || (outcome === "failed" ? trials[index].cells[this.outcome] !== "success" : trials[index].cells[this.outcome] === outcome)) &&
      (!band || band.has(trials[index].cells[this.world])) &&
      trials[index].cells[this.world] >= from && trials[index].cells[this.world] <= to &&
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
    const all = this.data.trials.length, filtered = FILTERS.some((id) => byId(id).value);
    byId("count").textContent = !rows.length ? "no such trial" : filtered ? `${rows.length} of ${all} trials` : `all ${all} trials`;
    byId("range").textContent = rows.length ? `${this.first + 1} to ${last} of ${rows.length}` : "";
    byId("earlier").disabled = this.first === 0;
    byId("later").disabled = last >= rows.length;
    document.querySelector("#trials tbody").replaceChildren(...rows.slice(this.first, last).map((index) => this.row(index)));
    const state = FILTERS.map((id) => byId(id).value).join("\n");
    if (state !== this.state) this.changed(rows);
    this.state = state;
  }

  row(index) {
    const trial = this.data.trials[index];
    const row = element("tr", { tabIndex: 0 });
    row.dataset.trial = trial.id;
    trial.cells.forEach((cell, at) => {
      const column = this.data.columns[at];
      const text = cell === null ? "-" : column.digits === null ? cell.replaceAll("_", " ") : cell.toFixed(column.digits);
      const made = element("td", { className: column.digits === null ? "" : "number", textContent: at ? text : "" });
      if (!at) made.append(dot(this.data.entries[trial.entry]), cell);
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
    const meters = (values) => Float32Array.from(values, (value) => value * world.step);
    this.world = world ? { ...world, cylinders: meters(map.cylinders), path: meters(map.path) } : null;
    this.walls = world?.moving ? new Shapes(map.box_walls) : null;
    this.movers = world?.moving && trial.phase !== undefined ? new MotionMovers(map, world.moving, trial.phase) : null;
    this.track = track;
    byId("trial-player").hidden = !track;
    byId("trial-scene").hidden = !track && !world;
    this.scene = new Scene(byId("trial-scene"), world ? this.room(world) : track ? around(track) : [0, 0, 1, 1]);
    if (track) this.play(track); else this.draw(0);
    this.opened = trial.id;
    document.body.dataset.opened = trial.id;
  }

  room({ bounds: [left, below, right, above], ends }) {
    const [lowest, highest] = minmax([below, above, ...ends.map(([, y]) => y)]);
    return [left, lowest - 0.8, right, highest + 0.8];
  }

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
      scene.discs(world.cylinders, world.radius, "obstacle");
      scene.line(world.path, "candidate", 1.4, [5, 4]);
      const [start, goal] = world.ends;
      if (start) scene.disc(...start, 0.12, "accent", true);
      if (goal) scene.star(...goal, "good");
      if (this.walls) this.walls.draw(scene, "wall");
      if (this.movers) this.movers.draw(scene, time);
    }
    if (track) {
      const at = Math.max(0, indexAt(track.time, time)), points = [];
      for (let i = 0; i < track.x.length; i++) points.push(track.x[i], track.y[i]);
      scene.context.globalAlpha = 0.3;
      scene.line(points, "trail", 2);
      scene.context.globalAlpha = 1;
      scene.line(points.slice(0, 2 * at + 2), "trail", 2.4);
      scene.robot(track.x[at], track.y[at], track.yaw[at], this.data.outline, track.contact[at]);
    }
    scene.end();
    if (track) this.drawCharts(time);
  }

  drawCharts(time) {
    const { track } = this;
    const pair = (driven, commanded) => [
      { name: "driven", color: "trail", values: track[driven] },
      { name: "commanded", color: "scan", values: track[commanded], dash: [5, 3] },
    ];
    const options = { cursor: time, marks: this.contacts };
    drawChart(byId("trial-chart-speed"), track.time, pair("speed", "command_speed"), { ...options, title: "forward speed", unit: "m/s" });
    drawChart(byId("trial-chart-turn"), track.time, pair("turn", "command_turn"), { ...options, title: "yaw rate", unit: "rad/s" });
    this.toTime = drawChart(byId("trial-chart-clearance"), track.time, [{ name: "clearance", color: "plan", values: track.clearance }],
      { ...options, title: `clearance to the ${this.movers ? "nearest obstacle" : "obstacles as they stood at the start"}`, unit: "m" });
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
    if (trial.touched) rows.push(["first contact with", trial.touched]);
    if (trial.phase !== undefined) rows.push(["phase of what moves", `${trial.phase.toFixed(2)} s`]);
    rows.push(["seeds", `campaign ${trial.seeds[0]}, simulator ${trial.seeds[1]}, planner ${trial.seeds[2]}`]);
    rows.push(["folder", entries[trial.entry].folder]);
    if (trial.bag) rows.push(["see it again", `barn replay ${trial.bag}`]);
    if (trial.replay) rows.push(["replay", element("a", { href: trial.replay, target: "_blank", rel: "noopener", textContent: "open the replay" })]);
    byId("trial-facts").replaceChildren(...rows.flatMap(([name, value]) => [element("dt", { textContent: name }), element("dd", {}, value)]));
  }
}

/* Maps of the hardest worlds: trajectories that the filters leave, and worlds without any faint. Paper has all. */
class Maps {
  constructor(data) {
    const world = data.columns.findIndex((column) => column.name === "world");
    this.marks = [...document.querySelectorAll("#figure-hardest [id^=hardest-trial-]")].map((mark) => ({ mark, row: Number(mark.id.split("-")[2]) }));
    this.maps = [...document.querySelectorAll("#figure-hardest [id^=hardest-world-]")].map((map) => ({ map, world: Number(map.id.split("-")[2]) }));
    this.worldOf = (row) => data.trials[row].cells[world];
  }

  show(rows) {
    const chosen = new Set(rows), worlds = new Set(rows.map(this.worldOf));
    for (const { mark, row } of this.marks) mark.classList.toggle("out", !chosen.has(row));
    for (const { map, world } of this.maps) map.classList.toggle("faint", !worlds.has(world));
  }
}

function around(track) {
  const [left, right] = minmax(Array.from(track.x)), [below, above] = minmax(Array.from(track.y));
  return [left - 1, below - 1, right + 1, above + 1];
}

{
  const data = JSON.parse(byId("data").textContent);
  const view = new TrialView(data);
  const show = (index) => view.open(index).catch((error) => {
    byId("trial-problem").hidden = false;
    byId("trial-problem").textContent = `It cannot be drawn: ${error.message}.`;
  });
  const maps = new Maps(data);
  const table = new TrialTable(data, show, (rows) => maps.show(rows));
  window.report = { data, view, table };
  document.body.dataset.ready = "yes";
}
