"use strict";

/* The replay of one trial. `window.replay` is there for those who drive the page by script. */

const LAYERS = [
  ["costmap", "local costmap", "cost"],
  ["candidates", "candidates", "candidate"],
  ["plan", "plan", "plan"],
  ["local_plan", "local plan", "local"],
  ["band", "band", "band"],
  ["scan", "scan", "scan"],
  ["trail", "trail", "trail"],
];

class Replay {
  constructor(data, arrays) {
    Object.assign(this, { data, arrays });
    this.scene = new Scene(document.getElementById("scene"), data.bounds);
    this.times = arrays.times;
    this.shown = Object.fromEntries(LAYERS.map(([name]) => [name, true]));
    this.mapImage = data.map ? this.grid(arrays.map, data.map, (value) => (value === 1 ? colour("map") : value === 2 ? colour("unknown") : null)) : null;
    this.contacts = spans(this.times, arrays.contact);
    const column = (array, width, index) => array.filter((_, i) => i % width === index);
    this.series = [
      ["chart-speed", "forward speed", "m/s", column(arrays.speeds, 2, 0), column(arrays.commands, 2, 0)],
      ["chart-turn", "yaw rate", "rad/s", column(arrays.speeds, 2, 1), column(arrays.commands, 2, 1)],
    ];
    this.layers();
    const element = (id) => document.getElementById(id);
    this.player = new Player(this.times[this.times.length - 1], { play: element("play"), scrub: element("scrub"), speed: element("speed"), clock: element("clock") }, (time) => this.draw(time));
    for (const [id] of this.series) {
      element(id).addEventListener("pointerdown", (event) => this.seekChart(id, event));
      element(id).addEventListener("pointermove", (event) => { if (event.buttons) this.seekChart(id, event); });
    }
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("resize", () => this.draw(this.player.time));
    onThemeChange(() => { this.repaint(); this.draw(this.player.time); });
  }

  repaint() {
    const { data, arrays } = this;
    if (data.map) this.mapImage = this.grid(arrays.map, data.map, (value) => (value === 1 ? colour("map") : value === 2 ? colour("unknown") : null));
    this.costImage = undefined;
  }

  layers() {
    const place = document.getElementById("layers");
    const there = { costmap: this.data.costmaps.length, scan: this.data.scan, trail: true };
    for (const [name, title, tint] of LAYERS) {
      const has = name in there ? there[name] : this.arrays[name + "_times"].length;
      const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: Boolean(has), disabled: !has, id: "layer-" + name });
      const key = Object.assign(document.createElement("span"), { className: "key" });
      key.style.background = `var(--${tint})`;
      const row = document.createElement("label");
      row.className = has ? "" : "absent";
      row.append(box, " ", key, has ? title : `${title} (not recorded)`);
      box.addEventListener("change", () => { this.shown[name] = box.checked; this.draw(this.player.time); });
      place.append(row);
    }
  }

  key(event) {
    if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName)) return;
    const step = event.shiftKey ? 1 : 0.1;
    if (event.key === " ") this.player.toggle();
    else if (event.key === "ArrowRight") this.player.seek(this.player.time + step);
    else if (event.key === "ArrowLeft") this.player.seek(this.player.time - step);
    else if (event.key === "Home") this.player.seek(0);
    else if (event.key === "End") this.player.seek(this.player.end);
    else return;
    event.preventDefault();
  }

  seekChart(id, event) {
    this.player.seek(this.toTime[id](event.offsetX));
  }

  /* An image of a grid, a pixel per cell; `tint` gives a colour or null for clear. */
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

  drawGrid(image, [columns, rows, resolution, x, y, frameX, frameY, frameYaw]) {
    const c = this.scene.context;
    c.save();
    c.imageSmoothingEnabled = false;
    c.translate(frameX, frameY);
    c.rotate(frameYaw);
    c.translate(x, y);
    c.scale(resolution, resolution);
    c.drawImage(image, 0, 0, columns, rows);
    c.restore();
  }

  draw(time) {
    const { arrays, data, scene } = this;
    const index = Math.max(0, indexAt(this.times, time));
    const [x, y, yaw] = arrays.poses.subarray(3 * index, 3 * index + 3);
    scene.begin();
    if (this.shown.costmap) this.drawCostmap(time);
    if (this.mapImage) this.drawGrid(this.mapImage, data.map);
    if (this.shown.candidates) this.drawLines("candidates", time, "candidate", 0.8);
    if (this.shown.plan) this.drawLines("plan", time, "plan", 2, [6, 4]);
    if (this.shown.band) this.drawBand(time);
    if (this.shown.local_plan) this.drawLines("local_plan", time, "local", 2.4);
    if (data.goal) scene.star(data.goal[0], data.goal[1], "good");
    if (this.shown.scan) this.drawScan(time, x, y, yaw);
    if (this.shown.trail) scene.line(trailPoints(arrays.poses, index), "trail", 2.2);
    scene.robot(x, y, yaw, data.extent, arrays.contact[index]);
    scene.end();
    this.toTime = {};
    for (const [id, title, unit, driven, commanded] of this.series) {
      this.toTime[id] = drawChart(document.getElementById(id), this.times, [
        { name: "driven", colour: "trail", values: driven },
        { name: "commanded", colour: "scan", values: commanded, dash: [5, 3] },
      ], { title, unit, cursor: time, marks: this.contacts });
    }
    this.read(index, time, x, y, yaw);
  }

  /* What the trial is worth at a time, and its outcome by then. */
  standing(time) {
    const { arrays, data } = this;
    const at = indexAt(arrays.score_times, time);
    if (at < 0) return "not recorded";
    const said = data.outcomes.filter(([since]) => since <= time + 1e-6).pop();
    return `${arrays.scores[at].toFixed(3)}${said ? ", " + said[1] : ""}`;
  }

  read(index, time, x, y, yaw) {
    const { arrays } = this;
    const put = (id, text) => { document.getElementById(id).textContent = text; };
    const number = (value, digits) => (Number.isFinite(value) ? value.toFixed(digits) : "none");
    put("pose", `x ${x.toFixed(2)} m, y ${y.toFixed(2)} m, yaw ${((yaw * 180) / Math.PI).toFixed(0)}°`);
    put("driven", `${number(arrays.speeds[2 * index], 2)} m/s, ${number(arrays.speeds[2 * index + 1], 2)} rad/s`);
    put("commanded", `${number(arrays.commands[2 * index], 2)} m/s, ${number(arrays.commands[2 * index + 1], 2)} rad/s`);
    put("score", this.standing(time));
    put("contact", arrays.contact[index] ? "touching" : "none");
  }

  drawLines(name, time, tint, pixels, dash) {
    const { arrays } = this;
    const at = indexAt(arrays[name + "_times"], time);
    if (at < 0) return;
    const first = arrays[name + "_lines"][at], last = arrays[name + "_lines"][at + 1], ends = arrays[name + "_ends"];
    for (let i = first; i < last; i++) this.scene.line(arrays[name + "_points"].subarray(2 * ends[i], 2 * ends[i + 1]), tint, pixels, dash);
  }

  drawBand(time) {
    const { arrays, scene } = this;
    const at = indexAt(arrays.band_times, time);
    if (at < 0) return;
    for (let i = arrays.bubble_ends[at]; i < arrays.bubble_ends[at + 1]; i++) {
      scene.disc(arrays.bubbles[3 * i], arrays.bubbles[3 * i + 1], arrays.bubbles[3 * i + 2], "band", false, 1.4);
    }
    this.drawLines("band", time, "band", 1.6);
  }

  drawCostmap(time) {
    const { arrays, data } = this;
    const at = indexAt(arrays.costmap_times, time);
    if (at < 0) return;
    if (this.costImage === undefined || this.costIndex !== at) {
      let offset = 0;
      for (let i = 0; i < at; i++) offset += data.costmaps[i][0] * data.costmaps[i][1];
      const [columns, rows] = data.costmaps[at];
      const paint = colour("cost");
      this.costImage = this.grid(arrays.costmap_cells.subarray(offset, offset + columns * rows), data.costmaps[at],
        (value) => (value ? paint + Math.round(20 + 9 * value).toString(16).padStart(2, "0") : null));
      this.costIndex = at;
    }
    this.drawGrid(this.costImage, data.costmaps[at]);
  }

  drawScan(time, x, y, yaw) {
    const { arrays, data, scene } = this;
    const at = data.scan ? indexAt(arrays.scan_times, time) : -1;
    if (at < 0) return;
    const [mountX, mountY, mountYaw] = data.lidar;
    const originX = x + Math.cos(yaw) * mountX - Math.sin(yaw) * mountY;
    const originY = y + Math.sin(yaw) * mountX + Math.cos(yaw) * mountY;
    const size = 3 * scene.pixel;
    scene.context.fillStyle = colour("scan");
    for (let i = 0; i < data.scan.beams; i++) {
      const range = arrays.scan_ranges[at * data.scan.beams + i];
      if (range === data.scan.no_range) continue;
      const angle = yaw + mountYaw + data.scan.angle_min + i * data.scan.angle_step;
      scene.context.fillRect(originX + (range / 100) * Math.cos(angle) - size / 2, originY + (range / 100) * Math.sin(angle) - size / 2, size, size);
    }
  }
}

function trailPoints(poses, index) {
  const points = new Float32Array(2 * (index + 1));
  for (let i = 0; i <= index; i++) { points[2 * i] = poses[3 * i]; points[2 * i + 1] = poses[3 * i + 1]; }
  return points;
}

(async () => {
  const data = JSON.parse(document.getElementById("data").textContent);
  try {
    window.replay = new Replay(data, await unpack(data.packed));
    document.body.dataset.ready = "yes";
  } catch (error) {
    const note = Object.assign(document.createElement("p"), { className: "note", textContent: `Nothing can be drawn: ${error.message}.` });
    document.querySelector("main").prepend(note);
    throw error;
  }
})();
