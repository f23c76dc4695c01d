/* A campaign's page: shows its state and asks for the next. Texts from files only ever become text nodes. */

const LEAST_PERIOD_MS = 3000;
const SHARE = 20; // of the time: the server computes at most one part in so many

function duration(seconds) {
  const whole = Math.round(seconds), pad = (number) => String(number).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${pad(Math.floor(whole / 60) % 60)}:${pad(whole % 60)}`;
}

function progress(state) {
  const parts = [state.planned === null ? `${state.done} trials` : `${state.done} of ${state.planned} trials`];
  if (state.again) parts.push(`${state.again} failed through no fault of the planner and will run again`);
  const finished = state.planned !== null && state.done >= state.planned;
  if (finished) parts.push("finished");
  if (!finished && state.per_minute !== null) parts.push(`${state.per_minute.toFixed(1)} per minute`);
  if (!finished && state.left_s !== null) parts.push(`${duration(state.left_s)} left`);
  if (!finished && state.last) parts.push(`last trial ended ${duration(Math.max(0, (Date.now() - Date.parse(state.last)) / 1000))} ago`);
  return parts.join(", ");
}

function bar(one) {
  const filled = element("span", { className: "bar" }), limits = element("span", { className: "limits" });
  filled.style.width = `${one.bar}%`;
  filled.style.background = one.color;
  limits.style.left = `${one.low}%`;
  limits.style.width = `${one.high - one.low}%`;
  return [element("span", { textContent: one.label }), element("span", { className: "track" }, filled, limits), element("span", { className: "number text", textContent: one.text })];
}

function row(trial) {
  const ending = trial.time_s === null ? trial.outcome + (trial.detail ? `: ${trial.detail}` : "") : `${trial.outcome} in ${trial.time_s.toFixed(2)} s`;
  const replay = trial.bag ? element("a", { href: `replay/${encodeURIComponent(trial.id)}`, target: "_blank", rel: "noopener", textContent: "replay", ariaLabel: `replay of ${trial.id}` }) : "no bag";
  return element("tr", {}, element("td", { className: "id", textContent: trial.id }), element("td", { textContent: trial.counts ? ending : `${ending} (not scored)` }), element("td", {}, replay));
}

/* Rows are replaced only where they differ, so that what has the focus keeps it. */
function fill(id, trials) {
  const text = JSON.stringify(trials), body = document.querySelector(`#${id} tbody`);
  if (body.dataset.shown === text) return;
  body.dataset.shown = text;
  body.replaceChildren(...trials.map(row));
}

function show(state) {
  byId("problem").hidden = !state.problem;
  byId("problem").textContent = state.problem;
  byId("title").textContent = state.title;
  if (state.problem) return;
  document.title = state.planned ? `${Math.floor((100 * state.done) / state.planned)}% ${state.title}` : state.title;
  byId("task").textContent = state.task || "";
  byId("progress-text").textContent = progress(state);
  byId("progress").value = state.planned ? state.done / state.planned : 0;
  byId("outcomes").textContent = state.outcomes.map(([name, count]) => `${name} ${count}`).join(", ");
  byId("verdict").textContent = state.verdict;
  byId("details").textContent = state.details;
  byId("metric").textContent = state.metric ? `${state.metric} that all planners have, with 95% intervals` : "";
  byId("bars").replaceChildren(...state.bars.flatMap(bar));
  byId("notes").replaceChildren(...state.notes.map((text) => element("p", { className: "note", textContent: text })));
  fill("failures", state.failures);
  fill("latest", state.latest);
}

async function update() {
  const began = performance.now();
  try {
    const answer = await fetch("state");
    if (!answer.ok) throw new Error(await answer.text());
    show(await answer.json());
    document.body.dataset.updates = Number(document.body.dataset.updates || 0) + 1;
  } catch (error) {
    byId("problem").hidden = false;
    byId("problem").textContent = `The server does not answer (${error.message}); this page may be out of date.`;
  }
  setTimeout(update, Math.max(LEAST_PERIOD_MS, SHARE * (performance.now() - began)));
}

show(JSON.parse(byId("data").textContent));
document.body.dataset.ready = "yes";
setTimeout(update, LEAST_PERIOD_MS);
