/* The report's maps, its table of trials and its view of one. Texts from files only ever become text nodes. */

const PAGE = 100;
const MAPS = 12; // so many at first, and so many more at a click
const NEAR_PX = 14; // a pointer this near to a trail or a marker means it
const FILTERS = ["search", "filter-planner", "filter-outcome", "filter-band", "filter-from", "filter-to"];

/* The parts of the page's data: in the page, or scripts beside it, which also a page of a disk may load. */
class Parts {
  constructor(data) {
    Object.assign(this, { data, loading: new Map(), receivers: new Map() });
    window.receive = (name, content) => this.receivers.get(name)?.(content);
  }

  get(name) {
    if (!this.loading.has(name)) this.loading.set(name, this.data.parts ? Promise.resolve(this.data.parts[name]) : this.load(name));
    return this.loading.get(name);
  }

  load(name) {
    return new Promise((resolve, reject) => {
      this.receivers.set(name, resolve);
      const script = element("script", { src: `${this.data.folder}/${name}.js` });
      script.addEventListener("error", () => reject(new Error(`${this.data.folder}/${name}.js, which belongs beside this page, cannot be read`)));
      script.addEventListener("load", () => script.remove());
      document.head.append(script);
    });
  }

  async world(place) {
    const part = await this.get(`world_${place}`);
    if (part.world && !part.map) {
      const map = await unpack(part.world.packed);
      const meters = (values) => Float32Array.from(values, (value) => value * part.world.step);
      Object.assign(part, { map, drawn: { ...part.world, cylinders: meters(map.cylinders), path: meters(map.path) } });
    }
    return part;
  }

  async track(part, index) {
    const record = part.trials[index];
    if (record.track && !record.unpacked) record.unpacked = await this.unpackTrack(record.track);
    return record.unpacked || null;
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
}

/* A text beside the pointer. */
const tip = {
  show(text, event) {
    const box = byId("tip");
    box.textContent = text;
    (byId("trial").open ? byId("trial") : document.body).append(box);
    box.hidden = false;
    box.style.left = `${Math.min(event.clientX + 14, innerWidth - box.offsetWidth - 6)}px`;
    box.style.top = `${event.clientY + 18 + box.offsetHeight > innerHeight ? event.clientY - box.offsetHeight - 10 : event.clientY + 18}px`;
  },
  hide() { byId("tip").hidden = true; },
};

function dot(entry) {
  const made = element("span", { className: `dot marker-${entry.marker}` });
  made.style.background = `var(--c-${entry.color.slice(1).toLowerCase()}, ${entry.color})`;
  return made;
}

class TrialTable {
  constructor(data, open, changed) {
    Object.assign(this, { data, open, changed, sorted: null, descending: false, first: 0 });
    this.outcome = data.columns.findIndex((column) => column.name === "outcome");
    this.texts = data.trials.map((trial) => `${trial.id} ${data.worlds[trial.place]} ${trial.detail} ${trial.outcome}`.toLowerCase());
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
    byId("count").textContent = !rows.length ? "no trials match" : filtered ? `${rows.length} of ${all} trials` : `all ${all} trials`;
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
    row.addEventListener("keydown", (event) => { if (event.key === "Enter") { event.preventDefault(); this.open(index); } });
    return row;
  }
}

class TrialView {
  constructor(data, parts) {
    Object.assign(this, { data, parts });
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
    const trial = this.data.trials[index];
    this.opened = null;
    this.index = index;
    tip.hide();
    if (!this.dialog.open) this.dialog.showModal();
    const part = await this.parts.world(trial.place), record = part.trials[index], world = part.drawn;
    this.facts(trial, record);
    const track = await this.parts.track(part, index);
    Object.assign(this, { world, map: part.map, track });
    this.movers = world?.moving && record.phase !== undefined ? new MotionMovers(part.map, world.moving, record.phase) : null;
    byId("trial-player").hidden = !track;
    byId("trial-scene").hidden = !track && !world;
    this.scene = new Scene(byId("trial-scene"), world ? roomOf(world) : track ? aroundTracks([track]) : [0, 0, 1, 1]);
    if (track) this.play(track); else this.draw(0);
    this.opened = trial.id;
    document.body.dataset.opened = trial.id;
  }

  /* Opens the trial so many further in the same world. */
  step(by) {
    const { trials } = this.data, rows = trials.map((_, row) => row).filter((row) => trials[row].place === trials[this.index].place);
    return rows[(rows.indexOf(this.index) + by + rows.length) % rows.length];
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
      drawWorld(scene, world, this.map, "obstacle");
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

  facts(trial, record) {
    const { columns, entries } = this.data;
        byId("trial-title").replaceChildren(dot(entries[trial.entry]), trial.id);
    byId("trial-ending").textContent = `${trial.outcome.replaceAll("_", " ")}${trial.detail ? ": " + trial.detail : ""} (${this.data.worlds[trial.place]})`;
    const notes = [record.problem, record.track ? record.track.note : ""].filter(Boolean);
    byId("trial-problem").hidden = !notes.length;
    byId("trial-problem").textContent = notes.join("; ");
    const rows = columns.map((column, at) => {
      const cell = trial.cells[at];
      return [column.title, cell === null ? "none" : column.digits === null ? cell : `${cell.toFixed(column.digits)} ${column.unit}`];
    });
    if (record.touched) rows.push(["first contact with", record.touched]);
    if (record.phase !== undefined) rows.push(["phase of moving obstacles", `${record.phase.toFixed(2)} s`]);
    rows.push(["seeds", `campaign ${record.seeds[0]}, simulator ${record.seeds[1]}, planner ${record.seeds[2]}`]);
    rows.push(["folder", entries[trial.entry].folder]);
    if (record.bag) rows.push(["see it again", `barn replay ${record.bag}`]);
    if (record.replay) rows.push(["replay", element("a", { href: record.replay, target: "_blank", rel: "noopener", textContent: "open the replay" })]);
    byId("trial-facts").replaceChildren(...rows.flatMap(([name, value]) => [element("dt", { textContent: name }), element("dd", {}, value)]));
  }
}

/* A map per world with the trails that the filters leave: small, drawn when it comes into view. */
class Maps {
  constructor(data, parts, open) {
    Object.assign(this, { data, parts, open, count: MAPS, rows: [], places: [] });
    this.seen = new IntersectionObserver((changes) => changes.filter((one) => one.isIntersecting).forEach((one) => this.draw(one.target)), { rootMargin: "300px" });
    for (const name of ["hardest", "contrast"]) this[name] = new Map(data.orders[name].map((world, place) => [world, place]));
    byId("sort-maps").addEventListener("change", () => { this.count = MAPS; this.arrange(); });
    byId("more-maps").addEventListener("click", () => { this.count += MAPS; this.arrange(); });
    byId("legend").replaceChildren(...data.entries.map((entry) => element("span", {}, this.sample(entry), dot(entry), entry.label)), element("span", { textContent: "× a failed trial's end" }), element("span", { textContent: "○ start" }), element("span", { textContent: "★ goal" }));
    const redraw = () => document.querySelectorAll("#maps figure").forEach((map) => { if (map.scene) this.draw(map); });
    addEventListener("resize", redraw);
    onThemeChange(redraw);
  }

  /* A piece of a planner's line. */
  sample(entry) {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), line = document.createElementNS("http://www.w3.org/2000/svg", "line");
    for (const [name, value] of Object.entries({ width: 34, height: 8, "aria-hidden": "true" })) svg.setAttribute(name, value);
    for (const [name, value] of Object.entries({ x1: 0, x2: 34, y1: 4, y2: 4, "stroke-width": 2, "stroke-dasharray": entry.dash.map((length) => 1.6 * length).join(" ") })) line.setAttribute(name, value);
    line.style.stroke = `var(--c-${entry.color.slice(1)}, ${entry.color})`;
    svg.append(line);
    return svg;
  }

  show(rows) {
    this.rows = rows;
    this.count = MAPS;
    this.arrange();
  }

  arrange() {
    const groups = new Map(), order = byId("sort-maps").value, { trials } = this.data;
    for (const row of this.rows) {
      const { place } = trials[row];
      if (!groups.has(place)) groups.set(place, []);
      groups.get(place).push(row);
    }
    const number = (place) => trials[groups.get(place)[0]].world;
    const rank = (place) => {
      if (order === "number") return number(place);
      const at = (order === "contrast" ? this.contrast : this.hardest).get(number(place)) ?? Infinity; // what not all planners have driven comes last
      return order === "easiest" ? -at : at;
    };
    const places = [...groups.keys()].sort((a, b) => rank(a) - rank(b) || number(a) - number(b));
    this.seen.disconnect();
    byId("maps").replaceChildren(...places.slice(0, this.count).map((place) => this.figure(place, number(place), groups.get(place))));
    byId("more-maps").hidden = places.length <= this.count;
    byId("more-maps").textContent = `More worlds (${this.count} of ${places.length} shown)`;
  }

  figure(place, world, rows) {
    const { trials, entries } = this.data;
    const counts = entries.map((entry, at) => {
      const own = rows.filter((row) => trials[row].entry === at);
      return own.length ? `${entry.label} ${own.filter((row) => trials[row].outcome === "success").length}/${own.length}` : "";
    }).filter(Boolean).join(", ");
    const canvas = element("canvas", { tabIndex: 0 });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `World ${world}, trails of ${rows.length} trials; successes: ${counts}. Enter opens the first.`);
    const map = element("figure", {}, canvas, element("figcaption", {}, element("strong", { textContent: `world ${world} ` }), counts));
    Object.assign(map, { place, rows });
    map.dataset.world = world;
    canvas.addEventListener("pointermove", (event) => this.point(map, event));
    canvas.addEventListener("pointerleave", () => { tip.hide(); this.mark(map, null); });
    canvas.addEventListener("click", (event) => this.open(this.nearest(map, event) ?? rows[0]));
    canvas.addEventListener("keydown", (event) => { if (event.key === "Enter") { event.preventDefault(); this.open(rows[0]); } });
    this.seen.observe(map);
    return map;
  }

  async draw(map) {
    try {
      map.loading ||= this.load(map);
      await map.loading;
      this.paint(map);
    } catch (error) {
      map.lastChild.textContent = `It cannot be drawn: ${error.message}.`;
    }
  }

  async load(map) {
    const part = await this.parts.world(map.place), { world } = part, trails = [];
    for (const row of map.rows) {
      const track = await this.parts.track(part, row).catch(() => null); // opened, the trial says what is wrong with it
      if (track) trails.push({ row, track });
    }
    const tracks = trails.map((one) => one.track);
    let bounds = tracks.length ? aroundTracks(tracks) : [0, 0, 1, 1];
    if (world) {
      // Corridors are longer than the course: what no robot came near is cut off.
      const [left, below, right, above] = roomOf(world), ends = world.ends.map(([, y]) => y);
      const [low, high] = minmax(tracks.flatMap((track) => [...track.y]).concat(ends));
      bounds = [left, Math.max(below, low - 0.8), right, Math.min(above, high + 0.8)];
    }
    const scene = new Scene(map.firstChild, bounds);
    scene.bare = true;
    Object.assign(map, { shown: part, trails, scene });
  }

  paint(map) {
    const { scene, shown, trails } = map, c = scene.begin(), { trials, entries } = this.data;
    if (shown.drawn) drawWorld(scene, shown.drawn, shown.map, "wall");
    for (const { row, track } of trails) {
      const { entry: at, outcome } = trials[row], entry = entries[at], points = [];
      for (let i = 0; i < track.x.length; i++) points.push(track.x[i], track.y[i]);
      c.globalAlpha = map.marked === undefined || map.marked === null ? 0.9 : map.marked === row ? 1 : 0.2;
      const pixels = map.marked === row ? 3 : 1.5;
      scene.line(points, entry.color, pixels, entry.dash.map((length) => 1.6 * length));
      const [x, y] = points.slice(-2);
      if (outcome === "success") markerAt(scene, x, y, entry.marker, entry.color); else scene.cross(x, y, entry.color);
      c.globalAlpha = 1;
    }
    scene.end();
    map.dataset.drawn = trails.map((one) => one.row).join(" ");
  }

  nearest(map, event) {
    if (!map.scene) return null;
    let least = NEAR_PX, found = null;
    for (const { row, track } of map.trails) {
      for (let i = 0; i < track.x.length; i++) {
        const apart = Math.hypot(map.scene.x(track.x[i]) - event.offsetX, map.scene.y(track.y[i]) - event.offsetY);
        if (apart < least) { least = apart; found = row; }
      }
    }
    return found;
  }

  mark(map, row) {
    if (!map.scene || (map.marked ?? null) === row) return;
    map.marked = row;
    this.paint(map);
  }

  point(map, event) {
    const row = this.nearest(map, event);
    this.mark(map, row);
    if (row === null) tip.hide(); else tip.show(describe(this.data, row), event);
  }
}

function describe(data, row) {
  const trial = data.trials[row];
  const cells = data.columns.map((column, at) => [column, trial.cells[at]]).slice(4, 6).filter(([, cell]) => cell !== null);
  const figures = cells.map(([column, cell]) => `${column.title} ${typeof cell === "boolean" ? cell : cell.toFixed(column.digits)} ${column.unit}`.trim());
  return [`${data.entries[trial.entry].label}, world ${trial.world}, trial ${trial.repetition}: ${trial.outcome.replaceAll("_", " ")}`, ...figures].join(", ");
}

function markerAt(scene, x, y, marker, name) {
  const c = scene.context, size = 4.5 * scene.pixel;
  const corners = {
    1: [[-1, -1], [1, -1], [1, 1], [-1, 1]], 2: [[0, 1], [1, -1], [-1, -1]], 3: [[0, 1.2], [1.2, 0], [0, -1.2], [-1.2, 0]], 4: [[-1, 1], [1, 1], [0, -1]],
    5: [[-0.4, 1.2], [0.4, 1.2], [0.4, 0.4], [1.2, 0.4], [1.2, -0.4], [0.4, -0.4], [0.4, -1.2], [-0.4, -1.2], [-0.4, -0.4], [-1.2, -0.4], [-1.2, 0.4], [-0.4, 0.4]],
    6: [[-0.5, 1.1], [0, 0.6], [0.5, 1.1], [1.1, 0.5], [0.6, 0], [1.1, -0.5], [0.5, -1.1], [0, -0.6], [-0.5, -1.1], [-1.1, -0.5], [-0.6, 0], [-1.1, 0.5]],
  }[marker];
  c.beginPath();
  if (corners) corners.forEach(([a, b]) => c.lineTo(x + a * size, y + b * size)); else c.arc(x, y, size, 0, 2 * Math.PI);
  c.closePath();
  c.fillStyle = color(name);
  c.fill();
}

function drawWorld(scene, world, map, obstacles) {
  scene.discs(world.cylinders, world.radius, obstacles);
  scene.line(world.path, "candidate", 1.4, [5, 4]);
  const [start, goal] = world.ends;
  if (start) scene.disc(...start, 5 * scene.pixel, "ink", false, 2);
  if (goal) scene.star(...goal, "good");
  if (world.moving) new Shapes(map.box_walls).draw(scene, "wall");
}

function roomOf({ bounds: [left, below, right, above], ends }) {
  const [lowest, highest] = minmax([below, above, ...ends.map(([, y]) => y)]);
  return [left, lowest - 0.8, right, highest + 0.8];
}

function aroundTracks(tracks) {
  const [left, right] = minmax(tracks.flatMap((track) => [...track.x])), [below, above] = minmax(tracks.flatMap((track) => [...track.y]));
  return [left - 1, below - 1, right + 1, above + 1];
}

/* Figures drawn beforehand: values beside the pointer, a click that opens the trial, files. */
class Figures {
  constructor(data, open) {
    Object.assign(this, { data, open });
    for (const figure of document.querySelectorAll("figure[id^=figure-]")) {
      const svg = figure.querySelector("svg"), name = figure.id.slice("figure-".length);
      svg.addEventListener("pointermove", (event) => { const known = this.at(svg, event); if (known) tip.show(known[0], event); else tip.hide(); });
      svg.addEventListener("pointerleave", () => tip.hide());
      svg.addEventListener("click", (event) => { const row = this.row(this.at(svg, event)); if (row >= 0) this.open(row); });
      for (const button of figure.querySelectorAll("[data-save]")) button.addEventListener("click", () => this.save(svg, name, button.dataset.save));
    }
  }

  /* The tip of what is under the pointer, else of the nearest marker. */
  at(svg, event) {
    const holder = event.target.closest("[data-tips]");
    if (holder) {
      const tips = JSON.parse(holder.dataset.tips), parts = this.parts(holder);
      return tips.length === 1 ? tips[0] : tips[parts.indexOf(event.target)];
    }
    let least = NEAR_PX, known;
    for (const { x, y, tip: one } of this.markers(svg)) {
      const apart = Math.hypot(x - event.clientX, y - event.clientY);
      if (apart < least) { least = apart; known = one; }
    }
    return known;
  }

  parts(holder) { return [...holder.querySelectorAll("use, path")].filter((one) => !one.closest("defs")).filter((one, _, all) => one.tagName === "use" || !all.some((other) => other.tagName === "use")); }

  markers(svg) {
    const places = [];
    for (const holder of svg.querySelectorAll("[data-tips]")) {
      const tips = JSON.parse(holder.dataset.tips), parts = this.parts(holder);
      if (parts[0]?.tagName !== "use" || parts.length !== tips.length) continue;
      parts.forEach((part, at) => {
        const box = part.getBoundingClientRect();
        places.push({ x: box.left + box.width / 2, y: box.top + box.height / 2, tip: tips[at] });
      });
    }
    return places;
  }

  row(known) {
    if (!known || known.length < 3) return -1;
    const [, entry, world, outcome, repetition] = known;
    return this.data.trials.findIndex((trial) => trial.entry === entry && trial.world === world && (!outcome || trial.outcome === outcome) && (repetition === undefined || trial.repetition === repetition + 1));
  }

  async save(svg, name, kind) {
    if (kind === "pdf") return this.download(name, Uint8Array.from(atob(this.data.pdf[name]), (c) => c.charCodeAt(0)), "application/pdf", kind);
    const [, , width, height] = svg.getAttribute("viewBox").split(" ").map(Number);
    const copy = svg.cloneNode(true);
    copy.setAttribute("width", `${width}pt`);
    copy.setAttribute("height", `${height}pt`);
    copy.querySelectorAll("[data-tips]").forEach((one) => one.removeAttribute("data-tips"));
    const paper = document.createElementNS("http://www.w3.org/2000/svg", "rect");
    for (const [key, value] of Object.entries({ width: "100%", height: "100%", fill: "#ffffff" })) paper.setAttribute(key, value);
    copy.prepend(paper);
    // Colors of a theme become those on white.
    const text = new XMLSerializer().serializeToString(copy).replaceAll(/var\([^,()]*, (#[0-9a-f]{6})\)/g, "$1").replaceAll("currentColor", "#010101");
    if (kind === "svg") return this.download(name, text, "image/svg+xml", kind);
    const picture = new Image(), canvas = element("canvas", { width: Math.round((width * 300) / 72), height: Math.round((height * 300) / 72) });
    picture.src = URL.createObjectURL(new Blob([text], { type: "image/svg+xml" }));
    await picture.decode();
    canvas.getContext("2d").drawImage(picture, 0, 0, canvas.width, canvas.height);
    canvas.toBlob((blob) => this.download(name, blob, "image/png", kind));
  }

  download(name, content, type, kind) {
    const link = element("a", { href: URL.createObjectURL(new Blob([content], { type })), download: `${name}.${kind}` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }
}

async function start() {
  const data = JSON.parse(byId("data").textContent), parts = new Parts(data);
  data.columns = data.columns.map(([name, title, unit, digits]) => ({ name, title, unit, digits }));
  const rows = await parts.get("trials");
  data.trials = rows.map(([id, entry, place, detail, ...cells]) => ({ id, entry, place, detail, world: cells[0], repetition: cells[1], outcome: cells[2], cells: [data.entries[entry].label, ...cells] }));
  const view = new TrialView(data, parts);
  const show = (index) => view.open(index).catch((error) => {
    byId("trial-problem").hidden = false;
    byId("trial-problem").textContent = `It cannot be drawn: ${error.message}.`;
  });
  byId("trial-before").addEventListener("click", () => show(view.step(-1)));
  byId("trial-after").addEventListener("click", () => show(view.step(1)));
  const figures = new Figures(data, show);
  const maps = new Maps(data, parts, show);
  const table = new TrialTable(data, show, (chosen) => maps.show(chosen));
  window.report = { data, view, table, maps, figures };
  document.body.dataset.ready = "yes";
}

start().catch((error) => {
  byId("count").textContent = `The trials cannot be shown: ${error.message}.`;
  document.body.dataset.ready = "no";
});
