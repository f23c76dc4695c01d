/* The replay of one trial, or of several on one clock. `window.replay` is there for those who drive the page by script. */

const LAYERS = [
  ["world", "world", "obstacle"],
  ["moving", "moving obstacles", "mover"],
  ["path", "path of the world", "soft"],
  ["map", "map given", "unknown"],
  ["costmap", "local costmap", "cost"],
  ["candidates", "candidates", "candidate"],
  ["plan", "plan", "plan"],
  ["local_plan", "local plan", "local"],
  ["band", "band", "band"],
  ["scan", "scan", "scan"],
  ["trail", "trail", "trail"],
];
// What is left out where several drive in one scene: nobody could tell whose it is. The rest takes the planner's color.
const SOLO = ["costmap", "candidates", "local_plan", "band"];

/* What one bag has: its arrays, what happened when, and how it is drawn into a scene. */
class Trial {
  constructor(data, arrays) {
    Object.assign(this, { data, arrays, times: arrays.times });
    this.contacts = spans(this.times, arrays.contact);
    this.movers = data.moving ? new RecordedMovers(arrays, data.moving) : null;
    const column = (array, index) => array.filter((_, i) => i % 2 === index);
    this.series = {
      speed: { driven: column(arrays.speeds, 0), commanded: column(arrays.commands, 0) },
      turn: { driven: column(arrays.speeds, 1), commanded: column(arrays.commands, 1) },
      clearance: { driven: arrays.clearance },
    };
    this.closest = arrays.clearance.reduce((best, gap, i) => (Number.isFinite(gap) && (best < 0 || gap < arrays.clearance[best]) ? i : best), -1);
    this.paint();
  }

  get end() { return this.times.at(-1); }

  has(layer) {
    const { arrays, data } = this;
    const there = { world: data.scene, moving: data.moving?.there, path: data.scene && arrays.path.length, map: data.map, costmap: data.costmaps.length, scan: data.scan, trail: true };
    return Boolean(layer in there ? there[layer] : arrays[layer + "_times"].length);
  }

  /* Images of grids, which are of the theme's colors. */
  paint() {
    const { arrays, data } = this;
    const filled = data.scene ? "unknown" : "map", unknown = data.scene ? null : "unknown";
    const tint = (value) => (value === 1 ? color(filled) : value === 2 && unknown ? color(unknown) : null);
    this.mapImage = data.map ? this.grid(arrays.map, data.map, tint) : null;
    this.costImage = undefined;
  }

  /* An image of a grid, a pixel per cell; `tint` gives a color or null for clear. */
  grid(cells, [columns, rows], tint) {
    const image = document.createElement("canvas");
    image.width = columns;
    image.height = rows;
    const context = image.getContext("2d");
    const known = new Map();
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const value = cells[row * columns + column];
        if (!known.has(value)) known.set(value, tint(value));
        const paint = known.get(value);
        if (paint) { context.fillStyle = paint; context.fillRect(column, row, 1, 1); }
      }
    }
    return image;
  }

  drawGrid(scene, image, [columns, rows, resolution, x, y, frameX, frameY, frameYaw]) {
    const c = scene.context;
    c.save();
    c.imageSmoothingEnabled = false;
    c.translate(frameX, frameY);
    c.rotate(frameYaw);
    c.translate(x, y);
    c.scale(resolution, resolution);
    c.drawImage(image, 0, 0, columns, rows);
    c.restore();
  }

  /* The ground: drawn once where several drive in one scene. */
  drawGround(scene, shown) {
    const { arrays, data } = this;
    if (shown.map && this.mapImage) this.drawGrid(scene, this.mapImage, data.map);
    if (data.scene && shown.world) {
      scene.discs(arrays.walls, data.scene.radius, "wall");
      scene.discs(arrays.obstacles, data.scene.radius, "obstacle");
      if (data.moving) new Shapes(arrays.box_walls).draw(scene, "wall");
    }
    if (data.scene && shown.path && arrays.path.length) scene.line(arrays.path, "soft", 1.2, [3, 4]);
    if (data.start) scene.disc(data.start[0], data.start[1], 5 * scene.pixel, "ink", false, 2);
    if (data.goal) {
      if (data.goal_distance) scene.disc(data.goal[0], data.goal[1], data.goal_distance, "good", false, 1.2);
      scene.star(data.goal[0], data.goal[1], "good");
    }
  }

  /* What there is at a time. `own`: the planner's color, where several drive in one scene. */
  drawAt(scene, time, shown, own = null) {
    const { arrays, data } = this;
    const index = Math.max(0, indexAt(this.times, time));
    const [x, y, yaw] = arrays.poses.subarray(3 * index, 3 * index + 3);
    const tint = (name) => own || name;
    if (!own && shown.moving && this.movers) this.movers.draw(scene, time);
    if (!own && shown.costmap) this.drawCostmap(scene, time);
    if (!own && shown.candidates) this.drawLines(scene, "candidates", time, "candidate", 0.8);
    if (shown.plan) this.drawLines(scene, "plan", time, tint("plan"), 2, [6, 4]);
    if (!own && shown.band) this.drawBand(scene, time);
    if (!own && shown.local_plan) this.drawLines(scene, "local_plan", time, "local", 2.4);
    if (shown.scan) this.drawScan(scene, time, x, y, yaw, tint("scan"));
    if (shown.trail) scene.line(arrays.poses.subarray(0, 3 * index + 3).filter((_, i) => i % 3 < 2), this.trailColor(own), 2.4);
    if (shown.world && time >= this.end - 1e-6) {
      for (let i = 0; i < arrays.pushed?.length; i += 2) scene.disc(arrays.pushed[i], arrays.pushed[i + 1], data.scene.radius, "bad", false, 1.6);
    }
    scene.robot(x, y, yaw, data.outline, arrays.contact[index], own || "robot");
    for (const [since] of this.contacts) if (since <= time + 1e-6) this.markPose(scene, since);
    return index;
  }

  trailColor(own) { return own || this.color || "trail"; }

  markPose(scene, time) {
    const at = 3 * indexAt(this.times, time);
    scene.cross(this.arrays.poses[at], this.arrays.poses[at + 1], "bad");
  }

  /* What the trial is worth at a time, and its outcome by then. */
  standing(time) {
    const { arrays, data } = this;
    const at = indexAt(arrays.score_times, time);
    if (at < 0) return "not recorded";
    const said = data.outcomes.filter(([since]) => since <= time + 1e-6).pop();
    return `${arrays.scores[at].toFixed(3)}${said ? ", " + said[1] : ""}`;
  }

  /* The figures of a time as texts, by the ids of their places. */
  read(time) {
    const { arrays } = this, index = Math.max(0, indexAt(this.times, time));
    const [x, y, yaw] = arrays.poses.subarray(3 * index, 3 * index + 3);
    const number = (value, digits) => (Number.isFinite(value) ? value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1") : "none");
    const pair = (values) => `${number(values[2 * index], 2)} m/s, ${number(values[2 * index + 1], 2)} rad/s`;
    return {
      pose: `x ${x.toFixed(2)} m, y ${y.toFixed(2)} m, yaw ${((yaw * 180) / Math.PI).toFixed(0)}°`,
      driven: pair(arrays.speeds),
      commanded: pair(arrays.commands),
      clearance: Number.isFinite(arrays.clearance[index]) ? `${arrays.clearance[index].toFixed(2)} m` : "not known",
      progress: arrays.progress.length ? `${arrays.progress[index].toFixed(2)} m` : "not known",
      contact: arrays.contact[index] ? "touching" : "none",
      score: this.standing(time),
    };
  }

  /* When something of a kind happened, in seconds. */
  events(kind) {
    if (kind === "contact") return this.contacts.map(([since]) => since);
    if (kind === "recovery") return this.data.recoveries;
    return this.closest < 0 ? [] : [this.times[this.closest]];
  }

  drawLines(scene, name, time, tint, pixels, dash) {
    const { arrays } = this;
    const at = indexAt(arrays[name + "_times"], time);
    if (at < 0) return;
    const first = arrays[name + "_lines"][at], last = arrays[name + "_lines"][at + 1], ends = arrays[name + "_ends"];
    for (let i = first; i < last; i++) scene.line(arrays[name + "_points"].subarray(2 * ends[i], 2 * ends[i + 1]), tint, pixels, dash);
  }

  drawBand(scene, time) {
    const { arrays } = this;
    const at = indexAt(arrays.band_times, time);
    if (at < 0) return;
    for (let i = arrays.bubble_ends[at]; i < arrays.bubble_ends[at + 1]; i++) {
      scene.disc(arrays.bubbles[3 * i], arrays.bubbles[3 * i + 1], arrays.bubbles[3 * i + 2], "band", false, 1.4);
    }
    this.drawLines(scene, "band", time, "band", 1.6);
  }

  drawCostmap(scene, time) {
    const { arrays, data } = this;
    const at = indexAt(arrays.costmap_times, time);
    if (at < 0) return;
    if (this.costImage === undefined || this.costIndex !== at) {
      let offset = 0;
      for (let i = 0; i < at; i++) offset += data.costmaps[i][0] * data.costmaps[i][1];
      const [columns, rows] = data.costmaps[at];
      const paint = color("cost");
      this.costImage = this.grid(arrays.costmap_cells.subarray(offset, offset + columns * rows), data.costmaps[at],
        (value) => (value ? paint + Math.round(20 + 9 * value).toString(16).padStart(2, "0") : null));
      this.costIndex = at;
    }
    this.drawGrid(scene, this.costImage, data.costmaps[at]);
  }

  drawScan(scene, time, x, y, yaw, tint) {
    const { arrays, data } = this;
    const at = data.scan ? indexAt(arrays.scan_times, time) : -1;
    if (at < 0) return;
    const [mountX, mountY, mountYaw] = data.lidar;
    const originX = x + Math.cos(yaw) * mountX - Math.sin(yaw) * mountY;
    const originY = y + Math.sin(yaw) * mountX + Math.cos(yaw) * mountY;
    const size = 3 * scene.pixel;
    scene.context.fillStyle = color(tint);
    for (let i = 0; i < data.scan.beams; i++) {
      const range = arrays.scan_ranges[at * data.scan.beams + i];
      if (range === data.scan.no_range) continue;
      const angle = yaw + mountYaw + data.scan.angle_min + i * data.scan.angle_step;
      scene.context.fillRect(originX + (range / 100) * Math.cos(angle) - size / 2, originY + (range / 100) * Math.sin(angle) - size / 2, size, size);
    }
  }
}

class Replay {
  constructor(trials) {
    this.trials = trials;
    this.many = trials.length > 1;
    this.shown = Object.fromEntries(LAYERS.map(([name]) => [name, true]));
    if (this.many) trials.forEach((trial) => { trial.color = trial.data.color; });
    this.view = new View(() => this.draw());
    this.scenes = trials.map((_, index) => new Scene(byId(index ? `scene-${index}` : "scene"), this.bounds()));
    this.scenes.forEach((scene) => this.view.add(scene));
    this.layers();
    const controls = { play: byId("play"), scrub: byId("scrub"), speed: byId("speed"), clock: byId("clock") };
    this.player = new Player(this.lastClock(), controls, () => this.draw());
    for (const name of ["speed", "turn", "clearance"]) {
      const canvas = byId("chart-" + name), seek = (event) => this.player.seek(this.toClock[name](event.offsetX));
      canvas.hidden = !trials.some((trial) => trial.series[name].driven.some(Number.isFinite));
      canvas.addEventListener("pointerdown", seek);
      canvas.addEventListener("pointermove", (event) => { if (event.buttons) seek(event); });
    }
    this.buttons();
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("resize", () => this.draw());
    onThemeChange(() => { this.trials.forEach((trial) => trial.paint()); this.draw(); });
  }

  /* What all trials need to be in view. */
  bounds() {
    const sides = [0, 1, 2, 3].map((side) => this.trials.map((trial) => trial.data.bounds[side]));
    return sides.map((values, side) => (side < 2 ? Math.min(...values) : Math.max(...values)));
  }

  get along() { return byId("align")?.value === "progress"; }

  get overlaid() { return byId("arrange")?.value === "overlay"; }

  lastClock() { return Math.max(...this.trials.map((trial) => (this.along ? trial.arrays.progress.at(-1) : trial.end))); }

  /* Between the shared clock and a trial's time: they are one, or the clock is how far along the path it has come. */
  timeOf(trial, clock = this.player.time) {
    if (!this.along) return Math.min(clock, trial.end);
    const { progress } = trial.arrays, at = progress.findIndex((meters) => meters >= clock - 1e-6);
    return at < 0 ? trial.end : trial.times[at];
  }

  clockOf(trial, time) { return this.along ? trial.arrays.progress[Math.max(0, indexAt(trial.times, time))] : time; }

  layers() {
    const place = byId("layers");
    for (const [name, title, tint] of LAYERS) {
      const has = this.trials.some((trial) => trial.has(name));
      if (name === "moving" && !has) continue;
      const box = element("input", { type: "checkbox", checked: has, disabled: !has, id: "layer-" + name });
      const key = element("span", { className: "key" });
      key.style.background = `var(--${tint})`;
      const row = document.createElement("label");
      row.className = [has ? "" : "absent", SOLO.includes(name) ? "solo" : ""].join(" ");
      row.append(box, " ", key, has ? title : `${title} (not recorded)`);
      box.addEventListener("change", () => { this.shown[name] = box.checked; this.draw(); });
      place.append(row);
    }
  }

  buttons() {
    const on = (id, act, event = "click") => byId(id)?.addEventListener(event, act);
    on("zoom-in", () => this.view.zoomBy(1.5));
    on("zoom-out", () => this.view.zoomBy(1 / 1.5));
    on("zoom-reset", () => this.view.reset());
    on("measure", () => this.measure());
    for (const kind of ["contact", "recovery", "closest"]) {
      const button = byId("to-" + kind);
      button.disabled = !this.trials.some((trial) => trial.events(kind).length);
      if (button.disabled) button.title = { contact: "no contact", recovery: "no recovery was reported", closest: "the world is not known" }[kind];
      button.addEventListener("click", () => this.jump(kind));
    }
    on("align", () => this.align(), "change");
    on("arrange", () => this.arrange(), "change");
    this.arrange();
  }

  align() {
    const { player } = this;
    player.pause();
    player.unit = this.along ? "m" : "s";
    player.end = player.controls.scrub.max = this.lastClock();
    player.seek(0);
  }

  arrange() {
    document.body.dataset.arranged = this.overlaid ? "overlay" : "beside";
    this.view.changed();
  }

  measure() {
    this.view.measure();
    byId("measure").setAttribute("aria-pressed", this.view.measuring);
    this.tell(this.view.measuring ? "Click two points to measure. With keys, move with W A S D and set a point with P." : "");
  }

  tell(text) { byId("told").textContent = text; }

  /* Goes to the next event of a kind after the clock, or the one before; after the last comes the first again. */
  jump(kind, back = false) {
    const found = this.trials.flatMap((trial) => trial.events(kind).map((time) => ({ trial, time, clock: this.clockOf(trial, time) })));
    if (!found.length) return;
    found.sort((a, b) => (a.clock - b.clock) * (back ? -1 : 1));
    const past = (one) => (back ? one.clock < this.player.time - 1e-3 : one.clock > this.player.time + 1e-3);
    const to = found.find(past) || found[0];
    this.player.pause();
    this.player.seek(to.clock);
    const { arrays, times, data } = to.trial, index = Math.max(0, indexAt(times, to.time));
    this.view.lookAt(arrays.poses[3 * index], arrays.poses[3 * index + 1]);
    const gap = arrays.clearance[index], what = { contact: "contact", recovery: "recovery", closest: "closest approach" }[kind];
    this.tell(`${this.many ? data.label + ": " : ""}${what} at ${to.time.toFixed(2)} s${Number.isFinite(gap) ? `, ${gap.toFixed(2)} m from the nearest obstacle` : ""}`);
  }

  key(event) {
    const { target, key } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || target.tagName === "SELECT") return;
    if (target.type === "range" && /^(Arrow|Home|End|Page)/.test(key)) return;
    if (["BUTTON", "INPUT", "SUMMARY"].includes(target.tagName) && target.type !== "range" && (key === " " || key === "Enter")) return;
    const step = event.shiftKey ? 1 : 0.1, { player, view } = this;
    const acts = {
      " ": () => player.toggle(),
      ArrowRight: () => player.seek(player.time + step),
      ArrowLeft: () => player.seek(player.time - step),
      Home: () => player.seek(0),
      End: () => player.seek(player.end),
      c: () => this.jump("contact", event.shiftKey),
      r: () => this.jump("recovery", event.shiftKey),
      n: () => this.jump("closest", event.shiftKey),
      "+": () => view.zoomBy(1.5),
      "=": () => view.zoomBy(1.5),
      "-": () => view.zoomBy(1 / 1.5),
      0: () => view.reset(),
      w: () => view.pan(0, 40),
      s: () => view.pan(0, -40),
      a: () => view.pan(40, 0),
      d: () => view.pan(-40, 0),
      m: () => this.measure(),
      p: () => view.putMiddle(),
    };
    const act = acts[key.length === 1 ? key.toLowerCase() : key];
    if (!act) return;
    act();
    event.preventDefault();
  }

  draw() {
    if (!this.player) return;
    const scenes = this.overlaid ? this.scenes.slice(0, 1) : this.scenes;
    scenes.forEach((scene, index) => {
      const drawn = this.overlaid ? this.trials : [this.trials[index]];
      scene.begin();
      drawn[0].drawGround(scene, this.shown);
      if (this.overlaid && this.shown.moving) this.drawMovers(scene, drawn);
      for (const trial of drawn) trial.drawAt(scene, this.timeOf(trial), this.shown, this.overlaid ? trial.color : null);
      this.view.draw(scene);
      scene.end();
    });
    this.charts();
    this.trials.forEach((trial, index) => {
      for (const [id, text] of Object.entries(trial.read(this.timeOf(trial)))) byId(index ? `${id}-${index}` : id).textContent = text;
    });
    if (this.view.length !== null) this.tell(`${this.view.length.toFixed(2)} m`);
  }

  /* What moves where several drive in one scene: of those whose time still runs. Where it differs, in the planners' colors. */
  drawMovers(scene, drawn) {
    const there = drawn.filter((trial) => trial.movers).sort((one, other) => other.end - one.end);
    const running = there.filter((trial) => this.timeOf(trial) < trial.end - 1e-6);
    const shown = running.length ? running : there.slice(0, 1);
    const places = shown.map((trial) => trial.movers.at(this.timeOf(trial)));
    const alike = places.every((one) => one.every((value, i) => Math.abs(value - places[0][i]) < 0.01));
    for (const trial of alike ? shown.slice(0, 1) : shown) trial.movers.draw(scene, this.timeOf(trial), alike ? null : trial.color);
  }

  charts() {
    const titles = { speed: ["forward speed", "m/s"], turn: ["yaw rate", "rad/s"], clearance: ["clearance", "m"] };
    const axis = this.along ? "along the path [m]" : "time [s]";
    const marks = this.trials.flatMap((trial) => trial.contacts.map((span) => span.map((time) => this.clockOf(trial, time))));
    this.toClock = {};
    for (const [name, [title, unit]] of Object.entries(titles)) {
      const canvas = byId("chart-" + name);
      if (canvas.hidden) continue;
      const [only] = this.trials;
      const series = this.many
        ? this.trials.map((trial) => ({ name: trial.data.label, color: trial.color, values: trial.series[name].driven, times: this.along ? trial.arrays.progress : trial.times }))
        : [
          { name: "driven", color: "trail", values: only.series[name].driven },
          ...(only.series[name].commanded ? [{ name: "commanded", color: "scan", values: only.series[name].commanded, dash: [5, 3] }] : []),
        ];
      this.toClock[name] = drawChart(canvas, only.times, series, { title, unit, axis, cursor: this.player.time, marks });
    }
  }
}

(async () => {
  const data = JSON.parse(byId("data").textContent);
  try {
    window.replay = new Replay(await Promise.all(data.trials.map(async (one) => new Trial(one, await unpack(one.packed)))));
    window.replay.draw();
    document.body.dataset.ready = "yes";
  } catch (error) {
    const note = element("p", { className: "note", textContent: `Nothing can be drawn: ${error.message}.` });
    document.querySelector("main").prepend(note);
    throw error;
  }
})();
