/* Moving obstacles with their recent trails, and the walls between them: in replays and in the report's view of a trial. */

/* Upright cylinders and boxes from above: rows of x, y, yaw, radius (of a cylinder) and both sizes (of a box), in meters. */
class Shapes {
  constructor(rows) { this.rows = rows; }

  /* Draws them where they are, or at places [x, y, x, y, ...]; rings where they are not filled. */
  draw(scene, name, places = null, filled = true) {
    const c = scene.context, { rows } = this;
    c.beginPath();
    for (let k = 0; k < rows.length / 6; k++) {
      const [ownX, ownY, yaw, radius, long, wide] = rows.subarray(6 * k, 6 * k + 6);
      const [x, y] = places ? [places[2 * k], places[2 * k + 1]] : [ownX, ownY];
      if (radius) { c.moveTo(x + radius, y); c.arc(x, y, radius, 0, 2 * Math.PI); continue; }
      const ux = Math.cos(yaw), uy = Math.sin(yaw);
      [[1, 1], [-1, 1], [-1, -1], [1, -1]].forEach(([i, j], corner) => {
        const along = (i * long) / 2, across = (j * wide) / 2;
        c[corner ? "lineTo" : "moveTo"](x + along * ux - across * uy, y + along * uy + across * ux);
      });
      c.closePath();
    }
    c.fillStyle = c.strokeStyle = color(name);
    c.lineWidth = (filled ? 1 : 2) * scene.pixel;
    if (filled) c.fill();
    c.stroke();
  }
}

/* What moves: `at` gives places [x, y, x, y, ...] at a time, `trail` those of one obstacle from now back. */
class Movers {
  constructor(shapes, trail) { Object.assign(this, { shapes: new Shapes(shapes), count: shapes.length / 6, trail }); }

  draw(scene, time, own = null) {
    const c = scene.context;
    c.globalAlpha = 0.55;
    for (let k = 0; k < this.count; k++) scene.line(this.trailOf(k, time), own || "mover", 2.2);
    c.globalAlpha = own ? 1 : 0.8;
    this.shapes.draw(scene, own || "mover", this.at(time), !own);
    c.globalAlpha = 1;
  }
}

/* As a bag has them: places at some times; between two an obstacle goes straight, unless it jumped. */
class RecordedMovers extends Movers {
  constructor(arrays, { step, trail, beyond }) {
    super(arrays.mover_shapes, trail);
    Object.assign(this, { step, beyond, times: arrays.mover_times, places: arrays.mover_places, jumps: arrays.mover_jumps });
  }

  place(index, k) { const i = 2 * (index * this.count + k); return [this.places[i] * this.step, this.places[i + 1] * this.step]; }

  at(time) {
    const { times, count } = this, found = new Float32Array(2 * count);
    const before = Math.max(0, Math.min(times.length - 2, indexAt(times, time))), after = Math.min(before + 1, times.length - 1);
    const period = times[after] - times[before] || 1;
    const share = Math.min(Math.max(0, time - times[before]), period + this.beyond) / period;
    for (let k = 0; k < count; k++) {
      const part = this.jumps[after * count + k] ? Math.floor(Math.min(1, share)) : share;
      const [x, y] = this.place(before, k), [nextX, nextY] = this.place(after, k);
      found[2 * k] = x + part * (nextX - x);
      found[2 * k + 1] = y + part * (nextY - y);
    }
    return found;
  }

  trailOf(k, time) {
    const now = this.at(time), points = [now[2 * k], now[2 * k + 1]];
    for (let i = indexAt(this.times, time); i >= 0 && this.times[i] >= time - this.trail; i--) {
      points.push(...this.place(i, k));
      if (this.jumps[i * this.count + k]) break;
    }
    return points;
  }
}

/* As a world has them: polynomials over the share of a piece of the period; `phase` is the time into the motions at time 0. */
class MotionMovers extends Movers {
  constructor(arrays, { powers, step, trail }, phase) {
    super(arrays.mover_shapes, trail);
    Object.assign(this, { arrays, powers, step, phase });
  }

  own(k, time) {
    const { mover_periods: periods, mover_phases: phases } = this.arrays, at = (time + this.phase + phases[k]) % periods[k];
    return at < 0 ? at + periods[k] : at;
  }

  placeOf(k, time) {
    const { mover_first: first, mover_begin: begin, mover_duration: duration, mover_coefficients: coefficients } = this.arrays;
    const own = this.own(k, time), piece = first[k] + Math.max(0, indexAt(begin.subarray(first[k], first[k + 1]), own));
    const share = Math.min(1, Math.max(0, (own - begin[piece]) / duration[piece]));
    return [0, 1].map((axis) => {
      const offset = (2 * piece + axis) * this.powers;
      let value = 0;
      for (let power = this.powers - 1; power >= 0; power--) value = value * share + coefficients[offset + power];
      return value * this.step;
    });
  }

  at(time) {
    const found = new Float32Array(2 * this.count);
    for (let k = 0; k < this.count; k++) found.set(this.placeOf(k, time), 2 * k);
    return found;
  }

  /* A motion that ends elsewhere than it begins jumps as its period ends. */
  trailOf(k, time) {
    const since = this.own(k, time), points = [];
    for (let back = 0; back <= this.trail + 1e-6; back += 0.1) {
      if (back > since && !this.arrays.mover_closed[k]) break;
      points.push(...this.placeOf(k, time - back));
    }
    return points;
  }
}
