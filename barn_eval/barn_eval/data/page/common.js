/* Shared by the report and the replay: unpacking of data, colors of the page, maps and charts on canvases. */

const TYPES = { Uint8Array, Int16Array, Uint16Array, Int32Array, Float32Array, Float64Array };

async function unpack(packed) {
  if (typeof DecompressionStream === "undefined") {
    throw new Error("this browser cannot unpack the page's data: it lacks DecompressionStream, which browsers have since 2023");
  }
  const bytes = Uint8Array.from(atob(packed.zlib), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const arrays = {};
  for (const [name, [type, offset, length]] of Object.entries(packed.arrays)) {
    arrays[name] = new TYPES[type](buffer, offset, length);
  }
  return arrays;
}

/* The color of that name on the page; a color itself, such as a planner's, is what it is. */
function color(name) {
  const themed = (property) => getComputedStyle(document.documentElement).getPropertyValue(property).trim();
  return name.startsWith("#") ? themed("--c-" + name.slice(1).toLowerCase()) || name : themed("--" + name);
}

function onThemeChange(redraw) {
  // paper is white and has a width of its own
  for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", redraw);
  for (const event of ["beforeprint", "afterprint"]) addEventListener(event, redraw);
}

/* Sizes the canvas to its place on the page in device pixels and returns a context that counts CSS pixels. */
function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

function niceStep(span, most) {
  const raw = span / Math.max(1, most);
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999);
}

function label(value, step) {
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return (Math.abs(value) < step * 1e-6 ? 0 : value).toFixed(digits);
}

/* A plan view in meters with axes; draw in meters between `begin` and `end`. `view`: {zoom, center} where it is not all of it. */
class Scene {
  constructor(canvas, bounds, view = null) {
    this.canvas = canvas;
    this.bounds = bounds;
    this.view = view;
  }

  begin() {
    const { context, width, height } = prepared(this.canvas);
    const [left, below, right, above] = this.bounds;
    const margin = this.bare ? { left: 4, right: 4, top: 4, bottom: 4 } : { left: 46, right: 8, top: 8, bottom: 40 };
    const inner = { width: width - margin.left - margin.right, height: height - margin.top - margin.bottom };
    this.scale = Math.max(1e-3, Math.min(inner.width / (right - left), inner.height / (above - below)));
    const near = this.view && this.view.zoom > 1 ? this.view : null;
    this.scale *= near ? near.zoom : 1;
    const [middleX, middleY] = near ? near.center : [(left + right) / 2, (below + above) / 2];
    this.originX = margin.left + inner.width / 2 - middleX * this.scale;
    this.originY = margin.top + inner.height / 2 + middleY * this.scale;
    const halfX = inner.width / 2 / this.scale, halfY = inner.height / 2 / this.scale;
    this.seen = near ? [middleX - halfX, middleY - halfY, middleX + halfX, middleY + halfY] : this.bounds;
    this.context = context;
    this.pixel = 1 / this.scale;
    if (!this.bare) this.axes();
    context.save();
    context.beginPath();
    const [seenLeft, seenBelow, seenRight, seenAbove] = this.seen;
    context.rect(this.x(seenLeft), this.y(seenAbove), (seenRight - seenLeft) * this.scale, (seenAbove - seenBelow) * this.scale);
    context.clip();
    context.translate(this.originX, this.originY);
    context.scale(this.scale, -this.scale);
    context.lineJoin = "round";
    return context;
  }

  end() { this.context.restore(); }

  x(meters) { return this.originX + meters * this.scale; }
  y(meters) { return this.originY - meters * this.scale; }

  /* The point in meters under a pixel of the canvas. */
  at(x, y) { return [(x - this.originX) / this.scale, (this.originY - y) / this.scale]; }

  axes() {
    const [left, below, right, above] = this.seen;
    const c = this.context;
    const step = niceStep(Math.max(right - left, above - below), Math.max(right - left, above - below) * this.scale / 60);
    c.font = "12px system-ui, sans-serif";
    c.strokeStyle = color("line");
    c.fillStyle = color("soft");
    c.lineWidth = 1;
    c.textAlign = "center";
    for (let x = Math.ceil(left / step) * step; x <= right + 1e-9; x += step) {
      c.beginPath(); c.moveTo(this.x(x), this.y(above)); c.lineTo(this.x(x), this.y(below)); c.stroke();
      c.fillText(label(x, step), this.x(x), this.y(below) + 15);
    }
    c.fillText("x [m]", this.x((left + right) / 2), this.y(below) + 32);
    c.textAlign = "right";
    for (let y = Math.ceil(below / step) * step; y <= above + 1e-9; y += step) {
      c.beginPath(); c.moveTo(this.x(left), this.y(y)); c.lineTo(this.x(right), this.y(y)); c.stroke();
      c.fillText(label(y, step), this.x(left) - 6, this.y(y) + 4);
    }
    c.save();
    c.translate(this.x(left) - 34, this.y((below + above) / 2));
    c.rotate(-Math.PI / 2);
    c.textAlign = "center";
    c.fillText("y [m]", 0, 0);
    c.restore();
  }

  line(points, name, pixels, dash) {
    const c = this.context;
    c.strokeStyle = color(name);
    c.lineWidth = pixels * this.pixel;
    c.setLineDash((dash || []).map((length) => length * this.pixel));
    c.beginPath();
    for (let i = 0; i < points.length; i += 2) c.lineTo(points[i], points[i + 1]);
    c.stroke();
    c.setLineDash([]);
  }

  disc(x, y, radius, name, filled, pixels) {
    const c = this.context;
    c.beginPath();
    c.arc(x, y, radius, 0, 2 * Math.PI);
    if (filled) { c.fillStyle = color(name); c.fill(); } else { c.strokeStyle = color(name); c.lineWidth = (pixels || 1) * this.pixel; c.stroke(); }
  }

  /* The robot's outline, with a line from its center to its front. */
  robot(x, y, yaw, outline, touching, name = "robot") {
    const c = this.context;
    c.save();
    c.translate(x, y);
    c.rotate(yaw);
    c.beginPath();
    if (outline.radius) c.arc(0, 0, outline.radius, 0, 2 * Math.PI);
    else {
      outline.corners.forEach(([a, b]) => c.lineTo(a, b));
      c.closePath();
    }
    c.globalAlpha = 0.35;
    c.fillStyle = color(touching ? "bad" : name);
    c.fill();
    c.globalAlpha = 1;
    c.lineWidth = (touching ? 3 : 1.6) * this.pixel;
    c.strokeStyle = color(touching ? "bad" : "ink");
    c.stroke();
    this.line([0, 0, outline.front, 0], touching ? "bad" : "ink", touching ? 3 : 1.6);
    c.restore();
  }

  /* Discs of one radius at points [x, y, x, y, ...]. */
  discs(points, radius, name) {
    const c = this.context;
    c.beginPath();
    for (let i = 0; i < points.length; i += 2) { c.moveTo(points[i] + radius, points[i + 1]); c.arc(points[i], points[i + 1], radius, 0, 2 * Math.PI); }
    c.fillStyle = color(name);
    c.fill();
  }

  cross(x, y, name) {
    const size = 5 * this.pixel;
    this.line([x - size, y - size, x + size, y + size], name, 2);
    this.line([x - size, y + size, x + size, y - size], name, 2);
  }

  star(x, y, name) {
    const c = this.context, size = 9 * this.pixel;
    c.beginPath();
    for (let i = 0; i < 10; i++) {
      const radius = i % 2 ? 0.42 * size : size, angle = Math.PI / 2 + (i * Math.PI) / 5;
      c.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
    }
    c.closePath();
    c.fillStyle = color(name);
    c.fill();
  }
}

/* A text as far as there is room for it, in pixels. */
function shortened(context, text, room) {
  if (context.measureText(text).width <= room) return text;
  let length = text.length;
  while (length && context.measureText(`${text.slice(0, length)}…`).width > room) length -= 1;
  return `${text.slice(0, length)}…`;
}

/* A chart over time. series: {name, color, values, dash, times if other than the common ones};
   options: {title, unit, cursor, marks: [[from, to]], axis}. */
function drawChart(canvas, times, series, options) {
  const { context: c, width, height } = prepared(canvas);
  const left = 46, right = width - 8, top = 22, bottom = height - 34;
  const values = series.flatMap((one) => Array.from(one.values)).filter(Number.isFinite);
  let low = Math.min(0, ...minmax(values)), high = Math.max(0, ...minmax(values));
  if (high - low < 1e-6) high = low + 1;
  const room = 0.06 * (high - low);
  low -= low < 0 ? room : 0;
  high += room;
  const end = Math.max(1e-3, ...series.map((one) => (one.times || times).at(-1) || 0));
  const x = (t) => left + ((right - left) * t) / end;
  const y = (v) => bottom - ((bottom - top) * (v - low)) / (high - low);
  c.font = "12px system-ui, sans-serif";
  c.lineWidth = 1;
  c.fillStyle = color("bad");
  c.globalAlpha = 0.18;
  for (const [from, to] of options.marks || []) c.fillRect(x(from), top, Math.max(2, x(to) - x(from)), bottom - top);
  c.globalAlpha = 1;
  const stepY = niceStep(high - low, (bottom - top) / 20), stepX = niceStep(end, (right - left) / 60);
  c.strokeStyle = color("line");
  c.fillStyle = color("soft");
  c.textAlign = "right";
  for (let v = Math.ceil(low / stepY) * stepY; v <= high; v += stepY) {
    c.beginPath(); c.moveTo(left, y(v)); c.lineTo(right, y(v)); c.stroke();
    c.fillText(label(v, stepY), left - 6, y(v) + 4);
  }
  c.textAlign = "center";
  for (let t = 0; t <= end + 1e-9; t += stepX) c.fillText(label(t, stepX), x(t), bottom + 15);
  c.fillText(options.axis || "time [s]", (left + right) / 2, bottom + 30);
  c.textAlign = "left";
  c.fillStyle = color("ink");
  const title = `${options.title} [${options.unit}]`;
  c.fillText(title, left, 13);
  let at = right;
  const each = (right - left - c.measureText(title).width) / series.length - c.measureText("─").width - 18;
  c.textAlign = "right";
  for (const one of series.length > 1 ? [...series].reverse() : []) {
    const name = shortened(c, one.name, each);
    c.fillStyle = color("ink");
    c.fillText(name, at, 13);
    at -= c.measureText(name).width + 4;
    c.fillStyle = color(one.color);
    c.fillText(one.dash ? "╌" : "─", at, 13);
    at -= c.measureText("─").width + 14;
  }
  for (const one of series) {
    c.strokeStyle = color(one.color);
    c.lineWidth = 1.6;
    c.setLineDash(one.dash || []);
    c.beginPath();
    let pen = false;
    const own = one.times || times;
    for (let i = 0; i < own.length; i++) {
      if (!Number.isFinite(one.values[i])) { pen = false; continue; }
      if (pen) c.lineTo(x(own[i]), y(one.values[i])); else c.moveTo(x(own[i]), y(one.values[i]));
      pen = true;
    }
    c.stroke();
  }
  c.setLineDash([]);
  if (options.cursor !== undefined) {
    c.strokeStyle = color("ink");
    c.lineWidth = 1;
    c.beginPath(); c.moveTo(x(options.cursor), top); c.lineTo(x(options.cursor), bottom); c.stroke();
  }
  return (pixel) => Math.min(end, Math.max(0, ((pixel - left) / (right - left)) * end));
}

function minmax(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) { if (value < low) low = value; if (value > high) high = value; }
  return values.length ? [low, high] : [];
}

/* The last index whose time is not after `time`. */
function indexAt(times, time) {
  let low = 0, high = times.length;
  while (low < high) { const middle = (low + high) >> 1; if (times[middle] <= time + 1e-6) low = middle + 1; else high = middle; }
  return low - 1;
}

/* Spans of time in which `flags` is set. */
function spans(times, flags) {
  const found = [];
  for (let i = 0; i < flags.length; i++) {
    if (!flags[i]) continue;
    if (i && flags[i - 1]) found[found.length - 1][1] = times[i]; else found.push([times[i], times[i]]);
  }
  return found;
}

/* Time that runs while it plays. `show` is called with each new time. */
class Player {
  constructor(end, controls, show) {
    this.end = end;
    this.unit = "s";
    this.show = show;
    this.time = 0;
    this.playing = false;
    this.controls = controls;
    controls.scrub.max = end;
    controls.scrub.step = "any";
    controls.play.addEventListener("click", () => this.toggle());
    controls.scrub.addEventListener("input", () => this.seek(Number(controls.scrub.value)));
    this.seek(0);
  }

  get speed() { return Number(this.controls.speed.value); }

  seek(time) {
    this.time = Math.min(this.end, Math.max(0, time));
    this.controls.scrub.value = this.time;
    this.controls.clock.textContent = `${this.time.toFixed(2)} / ${this.end.toFixed(2)} ${this.unit}`;
    this.controls.scrub.setAttribute("aria-valuetext", this.controls.clock.textContent);
    this.show(this.time);
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }

  play() {
    if (this.time >= this.end) this.seek(0);
    this.playing = true;
    this.controls.play.textContent = "Pause";
    let before = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      const time = this.time + (this.speed * (now - before)) / 1000;
      before = now;
      this.seek(time);
      if (time >= this.end) this.pause(); else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    this.playing = false;
    this.controls.play.textContent = "Play";
  }
}
