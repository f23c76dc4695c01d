"use strict";

/* The report's figures and tables, computed anew from the trials that filters leave. Names, digits, orders and bands are the report's. */

const TIME = "normalised_time_s_per_m";

const whenIdle = window.requestIdleCallback || setTimeout; // Safari has none

function figureOf(name) { return byId("figure-" + name); }

class Chosen {
  constructor(data, values) {
    Object.assign(this, data.choice, { data, values, metric: data.metric.name, safety: data.safety });
    const column = (name) => data.trials.map((trial) => trial.cells[data.columns.findIndex((one) => one.name === name)]);
    this.worlds = column("world");
    this.repetitions = column("trial");
    this.ended = column("outcome");
    this.keys = this.worlds.map((world, row) => `${world}/${this.repetitions[row]}`);
    this.shades = data.entries.map((entry) => shade(entry.colour));
    this.pending = [];
    this.inView = new Set();
    const observer = new IntersectionObserver((seen) => { for (const one of seen) this.inView[one.isIntersecting ? "add" : "delete"](one.target); });
    this.trails = new Map();
    for (const mark of document.querySelectorAll("#figure-hardest [id^=hardest-trial-]")) {
      const row = Number(mark.id.split("-")[2]);
      this.trails.set(row, [...(this.trails.get(row) || []), mark]);
    }
    this.figures = { trade: this.drawTrade, worlds: this.drawWorlds, bands: this.drawBands, outcomes: this.drawOutcomes, paired: this.drawPaired, distributions: this.drawDistributions, compute: this.drawCompute };
    for (const place of [...this.there().map(figureOf), ...document.querySelectorAll(".twice")]) observer.observe(place);
  }

  /* Do for all trials, where nobody sees it, what filters do, a part whenever the page is idle: the first finds compiled code. */
  prepare() {
    this.take(this.worlds.keys());
    const tables = this.shownTables().map((table) => () => this.fill(table)), figures = this.there().map((name) => () => this.draw(name));
    const parts = [() => this.measureHeadings(), () => this.sayWhoLeads(), ...tables, ...figures];
    const next = () => {
      if (!parts.length || this.used) return;
      parts.shift()();
      whenIdle(next);
    };
    next();
  }

  /* Names of the page's figures that filters act on, and its tables. */
  there() { return Object.keys(this.figures).filter((name) => byId("chosen-" + name)); }
  shownTables() { return [...document.querySelectorAll("[data-table]")]; }

  /* rows: places of trials; null for all of them, which the page shows as it came. What is out of view comes after what is in it. */
  show(rows) {
    this.used ||= Boolean(rows);
    clearTimeout(this.timer);
    this.filtered = Boolean(rows);
    document.body.toggleAttribute("data-filtered", this.filtered);
    const now = [], later = [], sort = (place, renew) => (this.inView.has(place) ? now : later).push(renew);
    if (rows) {
      this.take(rows);
      this.sayWhoLeads();
      this.trajectories(new Set(rows));
      for (const table of this.shownTables()) sort(table.closest(".twice"), () => this.fill(table));
    }
    for (const name of this.there()) if (rows || figureOf(name).hasAttribute("data-filtered")) sort(figureOf(name), () => this.renew(name));
    for (const renew of now) renew();
    this.pending = later;
    this.renewNext();
  }

  fill(table) {
    const name = table.dataset.table, lines = name.startsWith("paired_") ? this.pairedLines(Number(name.slice(7)) - 1) : this[`${name}Lines`](table);
    const texts = name === "bands" ? 2 : 1;
    table.tBodies[0].replaceChildren(...lines.map((cells) => element("tr", {}, ...cells.map((text, at) => element("td", { className: at < texts ? "" : "number", textContent: text })))));
  }

  take(rows) {
    this.groups = this.data.entries.map(() => []);
    for (const row of [...rows].sort((a, b) => a - b)) this.groups[this.data.trials[row].entry].push(row);
    this.matches = this.pairs.map(([a, b]) => matched(this.keys, this.groups[a], this.groups[b]));
    this.some = this.groups.map((group, at) => at).filter((at) => this.groups[at].length);
  }

  draw(name) { byId("chosen-" + name).replaceChildren(...[this.figures[name].call(this)].flat()); }

  /* Let a figure show the trials chosen, or all again. */
  renew(name) {
    if (this.filtered) this.draw(name);
    figureOf(name).toggleAttribute("data-filtered", this.filtered);
  }

  /* Do what is pending, each in a task of its own, so that none holds the page up. */
  renewNext() {
    if (this.pending.length) this.timer = setTimeout(() => { this.pending[0](); this.pending.shift(); this.renewNext(); });
  }

  grouped(key, rows) { return grouped(this.values[key], this.worlds, rows); }

  /* The estimate of a measure over some trials in the unit of its heading, with limits if they are wanted or exact. */
  estimate(key, rows, limits) {
    const groups = this.grouped(key, rows), { factor } = this.measures[key];
    if (!groups.size) return { estimate: NaN };
    const found = key === "success" ? shareOf(groups, this.quantiles) : meanOf(groups, limits);
    return Object.fromEntries(Object.entries(found).map(([name, value]) => [name, factor * value]));
  }

  /* The estimate as text; limits are written where they are exact. */
  text(key, rows) {
    const { estimate, low, high } = this.estimate(key, rows, false), { digits } = this.measures[key];
    return number(estimate, digits) + (low === undefined ? "" : ` [${number(low, digits)}, ${number(high, digits)}]`);
  }

  successes(rows) { return rows.filter((row) => this.ended[row] === "success").length; }

  /* Planners that have a trial left, best first. */
  ranked() {
    const sign = this.measures[this.metric].larger ? -1 : 1, values = this.some.map((at) => this.estimate(this.metric, this.groups[at]).estimate);
    const places = this.some.map((_, place) => place), last = (place) => Number(Number.isNaN(values[place]));
    return places.sort((a, b) => last(a) - last(b) || sign * (values[a] - values[b]) || a - b).map((place) => this.some[place]);
  }

  sayWhoLeads() {
    const best = this.ranked(), { title, unit } = this.measures[this.metric], { entries } = this.data;
    const rows = this.groups.flat(), count = new Set(rows.map((row) => this.worlds[row])).size;
    const plural = (n, name) => `${n} ${name}${n === 1 ? "" : "s"}`;
    const known = best.map((at) => ({ at, ...this.estimate(this.metric, this.groups[at], true), text: this.text(this.metric, this.groups[at]) }));
    const named = ({ at, text }) => `${text}${unit && ` ${unit}`} of ${entries[at].label}`;
    const [first, second] = known, ahead = second && first.estimate !== second.estimate;
    const order = first ? [`${entries[first.at].label}${ahead ? " is ahead," : ","} ${title} ${first.text}${unit && ` ${unit}`}`, ...(second ? [named(second)] : [])].join(" against ") : "none is left";
    const few = count && count < 10 ? ` Only ${plural(count, "world")}: limits are rough.` : "";
    byId("chosen-verdict").textContent = `Of ${plural(rows.length, "trial")} chosen in ${plural(count, "world")}: ${order}.${second ? " Not tested." : ""}${few}`;
    const most = Math.max(...known.flatMap(({ estimate, low, high }) => [estimate, low, high]).filter(Number.isFinite), 0) || 1;
    const share = (value) => `${((100 * Math.max(0, value || 0)) / most).toFixed(2)}%`;
    byId("chosen-bars").setAttribute("aria-label", known.map(({ at, text }) => `${entries[at].label} ${text}`).join("; ") || "no trial");
    byId("chosen-bars").replaceChildren(...known.flatMap(({ at, estimate, low = estimate, high = estimate, text }) => {
      const bar = element("span", { className: "bar" }), limits = element("span", { className: "limits" });
      Object.assign(bar.style, { width: share(estimate), background: this.shades[at] });
      Object.assign(limits.style, { left: share(low), width: share(high - low) });
      return [element("span", { textContent: entries[at].label }), element("span", { className: "track" }, bar, limits), element("span", { className: "number text", textContent: text })];
    }));
  }

  headlineLines() {
    return this.ranked().map((at) => {
      const rows = this.groups[at], worlds = new Set(rows.map((row) => this.worlds[row])).size;
      const cells = this.tables.headline.map((key) => this.text(key, rows) + (this.measures[key].successes ? ` of ${this.successes(rows)}` : ""));
      return [this.data.entries[at].label, `${rows.length} in ${worlds}`, ...cells, number(spreadOf(this.grouped(TIME, rows)), this.measures[TIME].digits)];
    });
  }

  measuresLines() { return this.tables.measures.map((key) => [this.measures[key].heading, ...this.groups.map((rows) => this.text(key, rows))]); }

  bandRows(band, at) {
    const inside = new Set(band.worlds);
    return this.groups[at].filter((row) => inside.has(this.worlds[row]));
  }

  bandsLines() {
    return this.bands.flatMap((band) => this.data.entries.map((entry, at) => [band.title, entry.label, this.bandRows(band, at)]))
      .filter(([, , rows]) => rows.length)
      .map(([title, label, rows]) => [title, label, String(rows.length), ...this.tables.bands.map((key) => this.text(key, rows))]);
  }

  outcomesLines(table) {
    const names = [...table.tHead.querySelectorAll("th")].slice(1).map((cell) => cell.textContent);
    return this.some.map((at) => [this.data.entries[at].label, ...names.map((name) => String(this.groups[at].filter((row) => this.ended[row] === name).length))]);
  }

  pair(number, key, limits) {
    return pairedOf(this.values[key], this.worlds, this.matches[number], this.measures[key].larger, limits);
  }

  pairedLines(place) {
    return this.tables.paired.map((key) => {
      const { heading, digits, factor } = this.measures[key], found = this.pair(place, key, false);
      const texts = [found.a, found.b, found.difference.estimate].map((value) => number(factor * value, digits));
      return [heading, ...texts, "not tested", number(found.improvement.estimate, 2), String(found.trials)];
    });
  }

  /* The names of planners under a figure. */
  names(more = [], look = (at) => this.data.entries[at].marker) { return legend([...more, ...this.some.map((at) => [this.data.entries[at].label, this.shades[at], look(at)])]); }

  axis(key) { return this.measures[key].heading; }

  drawTrade() {
    const keys = [this.safety, ...(this.groups.some((rows) => this.estimate("contact_s", rows).estimate > 0) ? ["contact_s"] : [])];
    const sheet = new Sheet(360, "Speed against safety, trials chosen"), up = this.groups.map((rows) => this.estimate(TIME, rows, true));
    sheet.panels(keys.map(() => 1)).forEach((panel, place) => {
      const across = this.groups.map((rows) => this.estimate(keys[place], rows, true)), larger = this.measures[keys[place]].larger;
      const spans = [across, up].map((side) => rangeOf(side.flatMap(({ estimate, low, high }) => [estimate, low, high]), false, 0.15));
      panel.axes({ ...spans[0], title: this.axis(keys[place]) }, { ...spans[1], title: place ? "" : this.axis(TIME) });
      for (const at of this.some) {
        const x = across[at], y = up[at];
        if (!Number.isFinite(x.estimate + y.estimate)) continue;
        panel.limits(x.estimate, y.estimate, x, this.shades[at], true);
        panel.limits(x.estimate, y.estimate, y, this.shades[at], false);
        panel.marks([[x.estimate, y.estimate]], this.data.entries[at].marker, this.shades[at], 1.4);
      }
      panel.note(larger ? "faster and safer ↘" : "↙ faster and safer", larger);
    });
    return [sheet.svg, this.names()];
  }

  /* The axis of worlds from easy to difficult. */
  rank() {
    const { places, worlds, title, named } = this.order, [low = 0, high = 1] = minmax(places), room = 0.5 + 0.01 * (high - low);
    const ticks = named ? { ticks: places.map((place, at) => [place, String(worlds[at])]) } : {};
    return { low: low - (title.includes("[rank]") ? room : 0.02 * (high - low)), high: high + (title.includes("[rank]") ? room : 0.02 * (high - low)), title: named ? "world, from easy to difficult [number]" : title, ...ticks };
  }

  drawWorlds() {
    const sheet = new Sheet(420, "Time per metre by world, trials chosen"), [panel] = sheet.panels([1]);
    const groups = this.groups.map((rows) => this.grouped(TIME, rows)), { places, worlds } = this.order;
    const lines = worlds.map((world, at) => [places[at], groups.map((group) => group.get(world)).filter(Boolean)]).filter(([, parts]) => parts.length)
      .map(([place, parts]) => ({ place, middle: mean(parts.map(mean)), spread: deviation(parts.flat()) }));
    const points = groups.map((group) => worlds.flatMap((world, at) => (group.has(world) ? [[places[at], mean(group.get(world))]] : [])));
    const high = rangeOf([...lines.map(({ middle, spread }) => middle + spread), ...points.flat().map(([, y]) => y)], true);
    panel.axes(this.rank(), { ...high, title: this.axis(TIME) });
    const outline = [...lines.map(({ place, middle, spread }) => [place, middle + spread]), ...[...lines].reverse().map(({ place, middle, spread }) => [place, middle - spread])];
    panel.line(outline, "none", { fill: "#8a8f98", "fill-opacity": 0.3 });
    panel.line(lines.map(({ place, middle }) => [place, middle]), "currentColor");
    for (const at of this.some) panel.marks(points[at], this.data.entries[at].marker, this.shades[at], worlds.length > 60 ? 0.7 : 1, { "fill-opacity": 0.8 });
    return [sheet.svg, this.names([["mean over planners", "currentColor", "none"], ["± standard deviation of its trials", "#8a8f9866"]])];
  }

  drawBands() {
    const keys = [...new Set([this.metric, "success", TIME])], sheet = new Sheet(370, "Metric, success and time by band of difficulty, trials chosen");
    sheet.panels(keys.map(() => 1)).forEach((panel, place) => {
      const key = keys[place], count = this.data.entries.length, wide = Math.min(0.16, 0.6 / count);
      const found = this.bands.map((band) => this.groups.map((_, at) => this.estimate(key, this.bandRows(band, at), true)));
      const up = key === "success" ? { low: 0, high: 104 } : rangeOf(found.flat().flatMap(({ estimate, low, high }) => [estimate, low, high]), false, 0.1);
      panel.axes({ low: -0.5, high: this.bands.length - 0.5, title: "worlds by difficulty [band]", ticks: this.bands.map(({ name, worlds }, at) => [at, `${name} (${worlds.length})`]) }, { ...up, title: this.axis(key) }, this.measures[key].title);
      found.forEach((estimates, band) => estimates.forEach((one, at) => {
        const x = band + (at - (count - 1) / 2) * wide;
        panel.limits(x, one.estimate, one, this.shades[at], false);
        panel.marks([[x, one.estimate]], this.data.entries[at].marker, this.shades[at], 1.1);
      }));
    });
    return [sheet.svg, this.names()];
  }

  drawOutcomes() {
    const heights = this.some.map((at) => Math.max(...this.data.trials.flatMap((trial, row) => (trial.entry === at ? [this.repetitions[row]] : []))));
    const tall = heights.map((height) => Math.min(14 * height, 115)), sheet = new Sheet(56 + sum(tall) + 40 * tall.length, "Outcome of every trial chosen");
    const column = new Map(this.order.worlds.map((world, at) => [world, at + 1])), there = new Set();
    let top = 26;
    this.some.forEach((at, place) => {
      const panel = new Panel(sheet.svg, { left: 70, top, width: SHEET - 86, height: tall[place] }), last = place === this.some.length - 1;
      const across = { ...this.rank(), low: 0.5, high: column.size + 0.5 };
      if (!this.order.named) across.title = "world, from easy to difficult [rank]";
      else across.ticks = this.order.worlds.map((world, rank) => [rank + 1, String(world)]);
      panel.axes(last ? across : { ...across, ticks: [], title: "" }, { low: heights[place], high: 0, ticks: [[0.5, "1"], [heights[place] - 0.5, String(heights[place])]].slice(0, heights[place]), title: "trial" }, this.data.entries[at].label);
      panel.add("path", { d: `M${panel.left},${top}h${panel.width}v${tall[place]}h${-panel.width}Z`, fill: this.no_trial });
      const cells = new Map();
      for (const row of this.groups[at]) {
        const x = column.get(this.worlds[row]), y = this.repetitions[row];
        if (x === undefined) continue;
        const d = `M${panel.x(x - 0.5)},${panel.y(y - 1)}H${panel.x(x + 0.5)}V${panel.y(y)}H${panel.x(x - 0.5)}Z`;
        cells.set(this.ended[row], (cells.get(this.ended[row]) || "") + d);
      }
      for (const [name, d] of cells) { there.add(name); panel.add("path", { d, fill: this.outcomes[name], "shape-rendering": "crispEdges" }); }
      top += tall[place] + 40;
    });
    return [sheet.svg, legend([["not chosen, or no trial", this.no_trial], ...Object.keys(this.outcomes).filter((name) => there.has(name)).map((name) => [name.replaceAll("_", " "), this.outcomes[name]])])];
  }

  drawPaired() {
    const sheet = new Sheet(90 + 36 * this.pairs.length, "Paired differences, trials chosen");
    const names = this.pairs.map(([a, b]) => `${this.data.entries[a].label} - ${this.data.entries[b].label}`);
    const kinds = [["success", "difference", "difference in success [points]", 0, "larger"], [TIME, "difference", `difference in ${this.axis(TIME)}`, 0, "smaller"], [TIME, "improvement", "probability that the first is faster", 0.5, "larger"]];
    sheet.panels([1, 1, 1], { left: Math.min(260, 20 + 7.5 * Math.max(...names.map((name) => name.length))), between: 20 }).forEach((panel, place) => {
      const [key, part, title, neutral, better] = kinds[place], factor = part === "difference" ? this.measures[key].factor : 1;
      const found = this.pairs.map((_, number) => this.pair(number, key, true)[part]).map(({ estimate, low, high }) => ({ estimate: factor * estimate, low: factor * low, high: factor * high }));
      const across = rangeOf([neutral, ...found.flatMap(({ estimate, low, high }) => [estimate, low, high])], false, 0.1);
      panel.axes({ ...across, title }, { low: names.length - 0.4, high: -0.6, ticks: place ? [] : names.map((name, at) => [at, name]), title: "" });
      panel.line([[neutral, -0.6], [neutral, names.length - 0.4]], "currentColor", { "stroke-dasharray": "5 4", "stroke-width": 1 });
      found.forEach((one, at) => {
        if (!Number.isFinite(one.estimate)) return;
        panel.limits(one.estimate, at, one, "currentColor", true);
        panel.marks([[one.estimate, at]], "o", "var(--paper)", 1, { stroke: "currentColor", "stroke-width": 1.4 });
      });
      const sides = better === "larger" ? ["second better", "first better"] : ["first better", "second better"];
      panel.add("text", { x: panel.left, y: panel.top - 8 }, `← ${sides[0]}`);
      panel.add("text", { x: panel.right, y: panel.top - 8, "text-anchor": "end" }, `${sides[1]} →`);
    });
    return sheet.svg;
  }

  drawDistributions() {
    const sheet = new Sheet(340, "Cumulative distributions over the trials chosen");
    sheet.panels(this.distributed.map(() => 1), { between: 32 }).forEach((panel, place) => {
      const key = this.distributed[place], sorted = this.groups.map((rows) => Float64Array.from(rows, (row) => this.values[key][row]).filter(Number.isFinite).sort());
      panel.axes({ ...rangeOf(sorted.flatMap((values) => [values[0], values.at(-1)])), title: this.axis(key) }, { low: 0, high: 1.02, title: place ? "" : "share of trials up to" });
      sorted.forEach((values, at) => {
        const steps = []; // one per half pixel
        values.forEach((value, index) => {
          const x = Math.round(2 * panel.x(value)) / 2, y = panel.y((index + 1) / values.length);
          if (steps.length && steps.at(-1)[0] === x) steps.at(-1)[1] = y; else steps.push([x, y]);
        });
        const d = `M${steps[0]?.[0]},${panel.bottom}${steps.map(([x, y]) => `H${x}V${y}`).join("")}`;
        if (steps.length) panel.add("path", { d, stroke: this.shades[at], fill: "none", "stroke-width": 1.8, "stroke-dasharray": DASHES[at % 4] });
      });
    });
    return [sheet.svg, this.names([], (at) => DASHES[at % 4])];
  }

  drawCompute() {
    const keys = Object.values(this.compute), known = keys.map((key) => this.some.map((at) => Float64Array.from(this.groups[at], (row) => this.values[key][row]).filter(Number.isFinite).sort()));
    const whole = minmax(known.flat().flatMap((values) => (values.length ? [quantile(values, 0.05), quantile(values, 0.95)] : [])));
    if (!whole.length) return element("p", { textContent: "The planners' computing time was not seen in these trials." });
    const labels = this.some.map((at) => this.data.entries[at].label), sheet = new Sheet(90 + 42 * labels.length, "Computing time per cycle, trials chosen");
    const across = { low: Math.max(whole[0], 1e-6) / 1.3, high: whole[1] * 1.3, log: true, title: "time per cycle [ms]" };
    sheet.panels([1, 1, 1], { left: Math.min(260, 20 + 8 * Math.max(...labels.map((name) => name.length))), between: 20 }).forEach((panel, place) => {
      panel.axes(across, { low: labels.length - 0.4, high: -0.6, ticks: place ? [] : labels.map((name, at) => [at, name]), title: "" }, Object.keys(this.compute)[place]);
      known[place].forEach((values, at) => {
        if (!values.length) return;
        const [low, first, middle, third, high] = [0.05, 0.25, 0.5, 0.75, 0.95].map((share) => quantile(values, share)), colour = this.shades[this.some[at]];
        const inside = values.filter((value) => value >= low && value <= high), y = (offset) => panel.y(at + offset);
        const [least, most] = [inside[0] ?? first, inside.at(-1) ?? third];
        const d = `M${panel.x(first)},${y(-0.3)}H${panel.x(third)}V${y(0.3)}H${panel.x(first)}ZM${panel.x(least)},${y(0)}H${panel.x(first)}M${panel.x(third)},${y(0)}H${panel.x(most)}M${panel.x(least)},${y(-0.15)}V${y(0.15)}M${panel.x(most)},${y(-0.15)}V${y(0.15)}`;
        panel.add("path", { d, stroke: colour, fill: "none", "stroke-width": 1.8 });
        panel.add("path", { d: `M${panel.x(middle)},${y(-0.3)}V${y(0.3)}`, stroke: colour, "stroke-width": 2.8 });
      });
    });
    return sheet.svg;
  }

  measureHeadings() {
    this.headings ||= [...document.querySelectorAll("#figure-hardest [id^=hardest-title-]")].map((heading) => ({ heading, world: Number(heading.id.split("-")[2]), box: heading.getBBox() }));
  }

  /* On the maps of the hardest worlds, what is not chosen is hidden, and titles count what is. */
  trajectories(rows) {
    this.measureHeadings();
    for (const [row, marks] of this.trails) for (const mark of marks) mark.classList.toggle("out", !rows.has(row));
    for (const old of document.querySelectorAll("#figure-hardest text.of-chosen")) old.remove();
    for (const { heading, world, box } of this.headings) {
      const own = [...rows].filter((row) => this.worlds[row] === world);
      byId(`hardest-world-${world}`).classList.toggle("faint", !own.length);
      heading.classList.add("out");
      const texts = [`world ${world}: ${this.order.s_per_m[this.order.worlds.indexOf(world)].toFixed(2)} s/m`, `${this.successes(own)} of ${own.length} chosen succeed`];
      texts.forEach((text, line) => heading.after(drawing("text", { class: "of-chosen", x: rounded(box.x), y: rounded(box.y + 9 + 13 * line), style: "font-size: 11px" }, text)));
    }
  }
}
