/* How plan views are looked at: zoom, pan and a ruler, alike in all scenes of a page, by mouse, touch, buttons and keys. */

const MOST_ZOOM = 40;

class View {
  constructor(redraw) {
    Object.assign(this, { redraw, zoom: 1, center: [0, 0], scenes: [], points: [], measuring: false, aiming: false });
    this.fingers = new Map();
  }

  add(scene) {
    const { canvas } = scene;
    this.scenes.push(scene);
    scene.view = this;
    canvas.addEventListener("wheel", (event) => {
      const factor = Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015));
      if (factor < 1 && this.zoom <= 1) return; // all of it is in view: the page scrolls on
      event.preventDefault();
      this.zoomBy(factor, scene, event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.down(scene, event));
    canvas.addEventListener("pointermove", (event) => this.move(scene, event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.up(scene, event));
    canvas.addEventListener("dblclick", () => { if (!this.measuring) this.reset(); });
  }

  /* Zooms about a pixel of a scene, which stays where it is; without one about the middle. */
  zoomBy(factor, scene = this.scenes[0], x = null, y = null) {
    const [left, below, right, above] = scene.seen;
    const middle = [(left + right) / 2, (below + above) / 2];
    const fixed = x === null ? middle : scene.at(x, y);
    const zoom = Math.min(MOST_ZOOM, Math.max(1, this.zoom * factor));
    const share = this.zoom / zoom;
    this.center = [0, 1].map((axis) => fixed[axis] + (middle[axis] - fixed[axis]) * share);
    this.zoom = zoom;
    this.changed();
  }

  /* Moves what is seen by pixels. */
  pan(x, y) {
    if (this.zoom <= 1) return;
    const { pixel } = this.scenes[0];
    this.center = [this.center[0] - x * pixel, this.center[1] + y * pixel];
    this.changed();
  }

  /* Zooms until so many meters around a point are seen. */
  lookAt(x, y, meters = 4) {
    const [left, below, right, above] = this.scenes[0].bounds;
    this.center = [x, y];
    this.zoom = Math.min(MOST_ZOOM, Math.max(1.01, this.zoom, Math.max(right - left, above - below) / meters));
    this.changed();
  }

  reset() {
    this.zoom = 1;
    this.changed();
  }

  changed() {
    const [left, below, right, above] = this.scenes[0].bounds;
    this.center = [Math.min(right, Math.max(left, this.center[0])), Math.min(above, Math.max(below, this.center[1]))];
    // One finger scrolls the page while all is seen, and moves the scene while it is not.
    for (const { canvas } of this.scenes) {
      canvas.style.touchAction = this.zoom > 1 || this.measuring ? "none" : "pan-y";
      canvas.style.cursor = this.measuring ? "crosshair" : this.zoom > 1 ? "grab" : "";
    }
    this.redraw();
  }

  down(scene, event) {
    scene.canvas.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    this.traveled = this.fingers.size > 1 ? Infinity : 0;
  }

  move(scene, event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.offsetX, y: event.offsetY };
    const others = [...this.fingers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    if (others.length === 1) {
      const [other] = others, apart = (at) => Math.hypot(at.x - other.x, at.y - other.y);
      this.zoomBy(apart(now) / Math.max(1, apart(before)), scene, (now.x + other.x) / 2, (now.y + other.y) / 2);
      this.pan((now.x - before.x) / 2, (now.y - before.y) / 2);
    } else if (!others.length) {
      this.traveled += Math.hypot(now.x - before.x, now.y - before.y);
      this.pan(now.x - before.x, now.y - before.y);
    }
    this.fingers.set(event.pointerId, now);
  }

  up(scene, event) {
    if (this.fingers.delete(event.pointerId) && this.measuring && this.traveled < 6 && event.type === "pointerup") {
      this.aiming = false;
      this.put(scene.at(event.offsetX, event.offsetY));
    }
  }

  /* Takes a point in meters as an end of the ruler, the third as the first of the next. */
  put(point) {
    this.points = this.points.length === 2 ? [point] : [...this.points, point];
    this.changed();
  }

  /* Takes the point in the middle of what is seen, which is marked from then on. */
  putMiddle() {
    if (!this.measuring) return;
    this.aiming = true;
    const [left, below, right, above] = this.scenes[0].seen;
    this.put([(left + right) / 2, (below + above) / 2]);
  }

  measure(on = !this.measuring) {
    Object.assign(this, { measuring: on, points: [], aiming: false });
    this.changed();
  }

  /* What the ruler says. */
  get length() {
    if (this.points.length < 2) return null;
    const [[x, y], [otherX, otherY]] = this.points;
    return Math.hypot(otherX - x, otherY - y);
  }

  draw(scene) {
    const { context: c, pixel } = scene;
    if (this.measuring && this.aiming) {
      const [left, below, right, above] = scene.seen, x = (left + right) / 2, y = (below + above) / 2, size = 12 * pixel;
      scene.line([x - size, y, x + size, y], "accent", 1.5);
      scene.line([x, y - size, x, y + size], "accent", 1.5);
    }
    for (const [x, y] of this.points) scene.disc(x, y, 4 * pixel, "accent", true);
    if (this.length === null) return;
    scene.line(this.points.flat(), "accent", 2);
    const [x, y] = [0, 1].map((axis) => (this.points[0][axis] + this.points[1][axis]) / 2);
    c.save();
    c.translate(x, y);
    c.scale(pixel, -pixel);
    c.font = "600 13px system-ui, sans-serif";
    c.textAlign = "center";
    const text = `${this.length.toFixed(2)} m`, width = c.measureText(text).width + 10;
    c.fillStyle = color("paper");
    c.fillRect(-width / 2, -27, width, 20);
    c.fillStyle = color("accent");
    c.fillText(text, 0, -12);
    c.restore();
  }
}
