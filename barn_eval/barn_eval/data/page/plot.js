"use strict";

/* Figures of the report as SVG, drawn from data in the look of those that come with the page. */

const SHEET = 1152; // pixels across
/* The corners of marks around their place, in pixels, by matplotlib's names of them. */
const MARKERS = {
  o: Array.from({ length: 14 }, (_, at) => [4.2 * Math.cos((at * Math.PI) / 7), 4.2 * Math.sin((at * Math.PI) / 7)]),
  s: [[-3.7, -3.7], [3.7, -3.7], [3.7, 3.7], [-3.7, 3.7]],
  "^": [[0, -4.8], [4.6, 3.8], [-4.6, 3.8]],
  D: [[0, -5.2], [5.2, 0], [0, 5.2], [-5.2, 0]],
  v: [[0, 4.8], [4.6, -3.8], [-4.6, -3.8]],
  P: plus(0),
  X: plus(Math.PI / 4),
};
const DASHES = ["none", "7 4", "7 3 2 3", "2 3"];

function drawing(tag, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function shade(colour) { return `var(--c-${colour.slice(1).toLowerCase()}, ${colour})`; }

class Sheet {
  constructor(height, about) {
    this.height = height;
    this.svg = drawing("svg", { viewBox: `0 0 ${SHEET} ${height}`, role: "img", "aria-label": about });
  }

  /* Panels side by side, of the widths given as shares; `room`: pixels around each. */
  panels(shares, room = {}) {
    const { left = 70, right = 16, top = 26, bottom = 48, between = left } = room, all = sum(shares);
    const free = SHEET - left - right - (shares.length - 1) * (between + 8);
    let at = left;
    return shares.map((share) => {
      const width = (free * share) / all, made = new Panel(this.svg, { left: at, top, width, height: this.height - top - bottom });
      at += width + between + 8;
      return made;
    });
  }
}

class Panel {
  constructor(svg, box) { Object.assign(this, { svg, ...box, right: box.left + box.width, bottom: box.top + box.height }); }

  add(tag, attributes, text) {
    const made = drawing(tag, attributes, text);
    this.svg.append(made);
    return made;
  }

  /* Axes: {low, high, title, log, ticks: [[value, text]] or [] for none}; numbers are found where there are no ticks. */
  axes(x, y, title = "") {
    Object.assign(this, { across: x, up: y });
    const lines = [];
    for (const [value, text] of ticksOf(x, this.width / 80)) {
      lines.push(`M${this.x(value)},${this.top}V${this.bottom}`);
      this.add("text", { x: this.x(value), y: this.bottom + 17, "text-anchor": "middle" }, text);
    }
    for (const [value, text] of ticksOf(y, this.height / 40)) {
      lines.push(`M${this.left},${this.y(value)}H${this.right}`);
      this.add("text", { x: this.left - 7, y: this.y(value) + 5, "text-anchor": "end" }, text);
    }
    this.add("path", { d: lines.join(""), stroke: "var(--line)", fill: "none" });
    this.add("path", { d: `M${this.left},${this.top}V${this.bottom}H${this.right}`, stroke: "currentColor", fill: "none" });
    this.add("text", { x: this.left + this.width / 2, y: this.bottom + 38, "text-anchor": "middle" }, x.title);
    const middle = this.top + this.height / 2, aside = this.left - 50;
    if (y.title) this.add("text", { x: aside, y: middle, "text-anchor": "middle", transform: `rotate(-90 ${aside} ${middle})` }, y.title);
    if (title) this.add("text", { x: this.left, y: this.top - 8 }, title);
  }

  x(value) { return rounded(this.left + this.width * along(this.across, value)); }
  y(value) { return rounded(this.bottom - this.height * along(this.up, value)); }

  /* Lines through points [[x, y], ...]. */
  line(points, colour, more = {}) {
    const d = points.map(([x, y], at) => `${at ? "L" : "M"}${this.x(x)},${this.y(y)}`).join("");
    if (d) this.add("path", { d, stroke: colour, fill: "none", "stroke-width": 1.8, ...more });
  }

  /* The limits of an estimate, along x or up y. */
  limits(x, y, { low, high }, colour, flat) {
    if (!Number.isFinite(low)) return;
    const [one, two] = flat ? [this.x(low), this.x(high)] : [this.y(low), this.y(high)], at = flat ? this.y(y) : this.x(x);
    const d = flat ? `M${one},${at}H${two}M${one},${at - 4}v8M${two},${at - 4}v8` : `M${at},${one}V${two}M${at - 4},${one}h8M${at - 4},${two}h8`;
    this.add("path", { d, stroke: colour, fill: "none", "stroke-width": 1.6 });
  }

  marks(points, marker, colour, size = 1, more = {}) {
    const d = points.filter(([x, y]) => Number.isFinite(x) && Number.isFinite(y)).map(([x, y]) => closed(MARKERS[marker], this.x(x), this.y(y), size));
    if (d.length) this.add("path", { d: d.join(""), fill: colour, ...more });
  }

  note(text, right) { this.add("text", { x: right ? this.right - 4 : this.left + 6, y: this.bottom - 8, "text-anchor": right ? "end" : "start" }, text); }
}

/* The corners of a plus sign, turned. */
function plus(angle) {
  const corners = [[-1.7, -5], [1.7, -5], [1.7, -1.7], [5, -1.7], [5, 1.7], [1.7, 1.7], [1.7, 5], [-1.7, 5], [-1.7, 1.7], [-5, 1.7], [-5, -1.7], [-1.7, -1.7]];
  return corners.map(([x, y]) => [x * Math.cos(angle) - y * Math.sin(angle), x * Math.sin(angle) + y * Math.cos(angle)]);
}

function closed(corners, x = 0, y = 0, size = 1) { return `M${corners.map(([dx, dy]) => `${rounded(x + size * dx)},${rounded(y + size * dy)}`).join("L")}Z`; }

function rounded(value) { return Math.round(100 * value) / 100; }

function along({ low, high, log }, value) {
  return log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
}

function ticksOf({ low, high, log, ticks }, most) {
  if (ticks) return ticks;
  if (log) {
    const found = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) for (const step of [1, 3]) found.push(step * 10 ** power);
    return found.filter((value) => value >= low * 0.999 && value <= high * 1.001).map((value) => [value, String(Number(value.toPrecision(3)))]);
  }
  const step = niceStep(high - low, most), found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) found.push([value, label(value, step)]);
  return found;
}

/* The range of values with some room; from zero where `zero`. */
function rangeOf(values, zero, room = 0.06) {
  const [low = 0, high = 1] = minmax(values.filter(Number.isFinite)), span = high - low || Math.abs(high) || 1;
  return zero ? { low: Math.min(0, low), high: high + room * (high - Math.min(0, low) || 1) } : { low: low - room * span, high: high + room * span };
}

/* Names with their marks; an item is [text, colour, marker or dash or null for a square]. */
function legend(items) {
  const made = element("p", { className: "legend" });
  for (const [text, colour, look = null] of items) {
    const key = drawing("svg", { viewBox: "-8 -6 16 12", "aria-hidden": "true" });
    if (look !== null && look in MARKERS) key.append(drawing("path", { d: closed(MARKERS[look]), fill: colour }));
    else if (look !== null) key.append(drawing("path", { d: "M-8,0H8", stroke: colour, "stroke-width": 2, "stroke-dasharray": look }));
    else key.append(drawing("rect", { x: -6, y: -5, width: 12, height: 10, fill: colour }));
    made.append(element("span", {}, key, text));
  }
  return made;
}
