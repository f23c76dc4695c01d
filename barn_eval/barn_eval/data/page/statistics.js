"use strict";

/* Statistics of the trials that filters leave, as barn_eval's analysis has them: a world is the unit of sampling. Estimates and the
   limits of shares are equal to its own; limits of other means are those of a percentile bootstrap with fewer draws, to be drawn only. */

const RESAMPLES = 1000;
const draws = new Map();

/* Places of worlds, RESAMPLES times `count` of them, the same ones each time (mulberry32). */
function drawn(count) {
  if (draws.size > 60) draws.clear();
  if (!draws.has(count)) {
    const places = new Uint16Array(RESAMPLES * count);
    let state = count;
    for (let i = 0; i < places.length; i++) {
      state = (state + 0x6d2b79f5) | 0;
      let t = Math.imul(state ^ (state >>> 15), 1 | state);
      t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
      places[i] = (((t ^ (t >>> 14)) >>> 0) * count) / 4294967296;
    }
    draws.set(count, places);
  }
  return draws.get(count);
}

function sum(values) {
  let total = 0;
  for (const value of values) total += value;
  return total;
}

function mean(values) { return values.length ? sum(values) / values.length : NaN; }

/* The value below which a share of sorted values lies, between two of them in proportion. */
function quantile(sorted, share) {
  const at = share * (sorted.length - 1), below = Math.floor(at);
  return sorted[below] + (at - below) * ((sorted[below + 1] ?? sorted[below]) - sorted[below]);
}

/* The finite values of some trials by world. */
function grouped(values, worlds, rows) {
  const groups = new Map();
  for (const row of rows) {
    if (!Number.isFinite(values[row])) continue;
    if (!groups.has(worlds[row])) groups.set(worlds[row], []);
    groups.get(worlds[row]).push(values[row]);
  }
  return groups;
}

/* The mean of all values of groups, each a world's, with the limits of a percentile bootstrap over worlds. */
function meanOf(groups, limits) {
  const sums = [], counts = [];
  for (const values of groups.values()) { sums.push(sum(values)); counts.push(values.length); }
  const estimate = sum(sums) / sum(counts), worlds = sums.length;
  if (!limits || worlds < 2) return { estimate };
  const places = drawn(worlds), found = new Float64Array(RESAMPLES);
  for (let draw = 0, at = 0; draw < RESAMPLES; draw++) {
    let total = 0, count = 0;
    for (const end = at + worlds; at < end; at++) { total += sums[places[at]]; count += counts[places[at]]; }
    found[draw] = total / count;
  }
  found.sort();
  return { estimate, low: quantile(found, 0.025), high: quantile(found, 0.975) };
}

/* The share of ones in groups of ones and zeros, with Wilson's limits for the effective number of trials; `quantiles`: Student's. */
function shareOf(groups, quantiles) {
  const parts = [...groups.values()], worlds = parts.length, trials = sum(parts.map((part) => part.length));
  const p = sum(parts.map(sum)) / trials;
  if (worlds < 2) return { estimate: p };
  const variance = (sum(parts.map((part) => (sum(part) - p * part.length) ** 2)) * worlds) / (worlds - 1) / trials ** 2;
  const effective = variance > 0 ? Math.min((p * (1 - p)) / variance, trials) : worlds, z = quantiles[worlds - 2];
  const whole = 1 + (z * z) / effective, middle = (p + (z * z) / (2 * effective)) / whole;
  const half = (z * Math.sqrt((p * (1 - p)) / effective + (z / (2 * effective)) ** 2)) / whole;
  return { estimate: p, low: Math.max(0, middle - half), high: Math.min(1, middle + half) };
}

function deviation(values) {
  const middle = mean(values);
  return Math.sqrt(mean(values.map((value) => (value - middle) ** 2)));
}

/* The standard deviation over a world's trials, averaged over worlds that have more than one. */
function spreadOf(groups) { return mean([...groups.values()].filter((part) => part.length > 1).map(deviation)); }

/* The trials [a, b] of two planners that have the same key, which is of world and repetition. */
function matched(keys, a, b) {
  const other = new Map(b.map((row) => [keys[row], row]));
  return a.filter((row) => other.has(keys[row])).map((row) => [row, other.get(keys[row])]);
}

/* Two planners on matched trials that both have a value for. */
function pairedOf(values, worlds, matches, larger, limits) {
  const pairs = matches.filter(([one, two]) => Number.isFinite(values[one]) && Number.isFinite(values[two]));
  const differences = new Map(), sides = new Map();
  for (const [one, two] of pairs) {
    const world = worlds[one];
    if (!sides.has(world)) { sides.set(world, [[], []]); differences.set(world, []); }
    sides.get(world)[0].push(values[one]);
    sides.get(world)[1].push(values[two]);
    differences.get(world).push(values[one] - values[two]);
  }
  const chance = ([left, right]) => {
    let better = 0;
    for (const x of left) for (const y of right) better += x === y ? 0.5 : Number(x > y === larger);
    return better / (left.length * right.length);
  };
  const chances = new Map([...sides].map(([world, both]) => [world, [chance(both)]]));
  return {
    trials: pairs.length,
    a: mean(pairs.map(([row]) => values[row])),
    b: mean(pairs.map(([, row]) => values[row])),
    difference: meanOf(differences, limits),
    improvement: meanOf(chances, limits),
  };
}

/* A number as Python writes it: a value midway between two goes to the even one. A dash for what is none. */
function number(value, digits) {
  if (!Number.isFinite(value)) return "-";
  const near = Math.abs(value).toFixed(digits);
  const rest = Math.abs(value).toFixed(Math.min(100, digits + 60)).split(".")[1].slice(digits);
  const even = /^50*$/.test(rest) && Number(near.at(-1)) % 2 ? (Number(near) - 10 ** -digits).toFixed(digits) : near;
  return value < 0 && Number(even) ? `-${even}` : even;
}
