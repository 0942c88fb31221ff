// The review page: which episodes are shown, and what is decided on them.

import {EpisodeView} from "/episode.js";
import {Grid} from "/grid.js";
import {Plot} from "/plot.js";
import {decide, get, keepClaim, playScene} from "/server.js";

const LARGE_TAIL = 0.05;  // share of the episodes with the smallest margin, and of the longest and shortest, that deserve a look

const find = (id) => document.getElementById(id);
const state = {names: {}, rows: [], byNumber: new Map(), decisions: new Map(), stale: new Set(), undo: [], range: null, open: null};
let picture, grid, plot, view, queue = Promise.resolve();

function fail(text) {
  find("message").textContent = text;
  find("message").hidden = !text;
}

const decisionOf = (episode) => state.decisions.get(episode);
const kindOf = (episode) => decisionOf(episode)?.decision ?? "undecided";
const isTrimmed = (decision) => decision && (decision.first_frame != null || decision.last_frame != null);

/** Give each row `look`: problems and stale decisions count most, then failures, recoveries, and values in the tails. */
function rankRows() {
  const tails = (key, low) => {
    const values = state.rows.map((row) => row[key]).filter((value) => value != null).sort((a, b) => a - b);
    return values[Math.floor((values.length - 1) * (low ? LARGE_TAIL : 1 - LARGE_TAIL))];
  };
  const shortest = tails("frames", true), longest = tails("frames", false), tight = tails("margin", true);
  const far = tails("distance_mm", false), jerky = tails("jerk", false), apart = tails("gap_mrad", false);
  for (const row of state.rows) {
    row.look = 4 * (row.problems?.length ?? 0) + 4 * state.stale.has(row.episode) + 3 * (row.success === false)
      + 2 * (row.recoveries ?? 0) + (row.margin < tight) + (row.distance_mm > far)
      + (row.jerk > jerky) + (row.gap_mrad > apart) + (row.frames < shortest) + (row.frames > longest);
  }
}

function describe(episode) {
  const row = state.byNumber.get(episode), decision = decisionOf(episode), kind = kindOf(episode);
  const notes = [...(decision?.tags ?? []), decision?.note].filter(Boolean).join(", ");
  const title = `${episode}${row.phrase ? ` ${row.phrase}` : row.origin ? ` ${row.origin}` : ""}`;
  const facts = [
    `${row.frames} frames`, row.distance_mm != null && `${row.distance_mm} mm`, row.margin != null && `margin ${row.margin}`,
    row.jerk != null && `jerk ${Math.round(row.jerk)}`, row.gap_mrad != null && `gap ${row.gap_mrad} mrad`,
    row.recoveries && `${row.recoveries} recoveries`, row.cause, ...(row.problems ?? []),
    isTrimmed(decision) && "trimmed", state.stale.has(episode) && "stale", notes,
  ].filter(Boolean).join(" · ");
  return {title, facts, kind, label: `Episode ${title}, ${kind}, ${facts}`};
}

function matches(row) {
  const decision = decisionOf(row.episode), wanted = find("decision-filter").value, range = state.range;
  if (wanted === "trimmed" ? !isTrimmed(decision) : wanted === "stale" ? !state.stale.has(row.episode)
    : wanted && kindOf(row.episode) !== wanted) return false;
  if (range) {
    const x = row[find("plot-x").value], y = row[find("plot-y").value];
    if (x == null || y == null || x < range.x[0] || x > range.x[1] || y < range.y[0] || y > range.y[1]) return false;
  }
  const search = find("search").value.trim().toLowerCase();
  if (!search) return true;
  if (/^\d+$/.test(search)) return row.episode === Number(search);
  const texts = [row.phrase, row.objects, row.cause, row.origin, row.format, ...(row.problems ?? []), ...(decision?.tags ?? []), decision?.note];
  return texts.some((text) => text?.toLowerCase().includes(search));
}

/** Apply filter, range and order. */
function update() {
  const key = find("sort").value, sign = find("descending").checked ? -1 : 1;
  const shown = state.rows.filter(matches);
  const value = (row) => Array.isArray(row[key]) ? row[key].length : row[key];
  shown.sort((a, b) => {
    const [one, other] = [value(a), value(b)];
    if (one == null || other == null) return (one == null) - (other == null) || a.episode - b.episode;
    return (one < other ? -sign : one > other ? sign : 0) || a.episode - b.episode;
  });
  plot.shown = new Set(shown.map((row) => row.episode));
  grid.show(shown.map((row) => row.episode), grid.current);
  mark(grid.current);
  count();
}

function mark(episode) {
  plot.marked = episode;
  plot.draw();
}

function count() {
  let kept = 0, dropped = 0;
  for (const each of state.decisions.values()) { kept += each.decision === "keep"; dropped += each.decision === "drop"; }
  const all = state.rows.length, left = all - kept - dropped;
  const rule = state.undecided === "keep" ? "kept" : "left out";
  find("counts").textContent = `${grid.order.length} of ${all} shown · ${kept} keep · ${dropped} drop · ${left} undecided, which are ${rule}`;
}

function setRange(range) {
  state.range = plot.range = range;
  for (const axis of ["x", "y"]) {
    find(`${axis}-from`).value = range ? Number(range[axis][0].toPrecision(5)) : "";
    find(`${axis}-to`).value = range ? Number(range[axis][1].toPrecision(5)) : "";
  }
  update();
}

function readRange() {
  const number = (id, otherwise) => find(id).value === "" ? otherwise : Number(find(id).value);
  const range = {};
  for (const axis of ["x", "y"]) {
    range[axis] = [number(`${axis}-from`, plot.bounds[axis][0]), number(`${axis}-to`, plot.bounds[axis][1])];
  }
  state.range = plot.range = range;
  update();
}

/** Store values of the decision on an episode; decisions are sent one after the other. */
function change(episode, values, undo = true) {
  if (episode == null) return queue;
  queue = queue.then(async () => {
    const before = decisionOf(episode) ?? {decision: "undecided", first_frame: null, last_frame: null, tags: [], note: ""};
    const {decision, first_frame, last_frame, tags, note} = {...before, ...values};
    try {
      const made = await decide({episode, decision, first_frame, last_frame, tags, note});
      if (made) state.decisions.set(episode, made);
      else state.decisions.delete(episode);
      if (undo) state.undo.push({episode, before});
      state.stale.delete(episode);
      fail("");
    } catch (error) {
      fail(error.message === "Failed to fetch" ? "`yamsim review` has ended: the decision is not stored." : error.message);
    }
    grid.refresh();
    mark(grid.current);
    count();
    showDecision();
  });
  return queue;
}

function undo() {
  queue = queue.then(() => {
    const last = state.undo.pop();
    if (last) change(last.episode, last.before, false);
  });
}

const current = () => state.open ?? grid.current;

function showDecision() {
  if (state.open == null) return;
  const decision = decisionOf(state.open), kind = kindOf(state.open);
  for (const button of document.querySelectorAll("[data-decide]")) button.ariaPressed = button.dataset.decide === kind;
  const first = decision?.first_frame, last = decision?.last_frame;
  const texts = [
    `Decision: ${kind}`, isTrimmed(decision) && `frames ${first ?? 0} to ${last ?? "the last"}`,
    decision?.tags.length && `tags: ${decision.tags.join(", ")}`, decision?.note && `note: ${decision.note}`,
    state.stale.has(state.open) && "its content has changed since it was decided",
  ];
  find("decision").textContent = texts.filter(Boolean).join(" · ");
  view.setTrim(first, last);
}

async function open(episode) {
  state.open = episode;
  find("overview").hidden = true;
  find("episode").hidden = false;
  find("episode-title").textContent = `Episode ${describe(episode).title}`;
  find("episode-title").focus();
  showDecision();
  fail("");
  find("scene-state").textContent = "";
  find("episode").ariaBusy = "true";
  try {
    await view.open(episode);
    showDecision();
  } catch (error) {
    fail(error.message);
  }
  if (state.open === episode) find("episode").ariaBusy = "false";
}

function close() {
  view.pause();
  state.open = null;
  find("episode").hidden = true;
  find("overview").hidden = false;
  grid.layout();
  grid.reveal();
  find("grid").focus();
}

/** Go to the undecided episode with the highest priority; among equals, to the next one. */
function next() {
  const here = current() ?? -1;
  let best = null;
  const after = (row) => (row.episode > here ? 0 : 1);
  for (const row of state.rows) {
    if (kindOf(row.episode) !== "undecided" || row.episode === here) continue;
    if (!best || row.look > best.look || (row.look === best.look && after(row) < after(best))) best = row;
  }
  if (!best) return fail("Every episode is decided.");
  const index = grid.order.indexOf(best.episode);
  if (index >= 0) grid.move(index);
  open(best.episode);
}

/** Ask for a line of text, and return a promise of it; null if the person cancels. */
function ask(name, text) {
  const box = find("entry");
  find("entry-name").textContent = name;
  find("entry-text").value = text;
  box.returnValue = "";
  box.showModal();
  find("entry-text").select();
  return new Promise((done) => {
    box.addEventListener("close", () => done(box.returnValue === "ok" ? find("entry-text").value : null), {once: true});
  });
}

async function askTags() {
  const episode = current(), text = await ask("Tags, separated by commas", (decisionOf(episode)?.tags ?? []).join(", "));
  if (text != null) change(episode, {tags: [...new Set(text.split(",").map((tag) => tag.trim()).filter(Boolean))]});
}

async function askNote() {
  const episode = current(), text = await ask("Note", decisionOf(episode)?.note ?? "");
  if (text != null) change(episode, {note: text.trim()});
}

/** Play the 3D scene on a page of its own. The page opens at once, because browsers refuse one that opens later. */
async function showScene() {
  if (state.open == null) return;
  const page = window.open("about:blank"), told = find("scene-state"), link = document.createElement("a");
  told.textContent = "The 3D scene is being built, which takes some seconds.";
  try {
    link.href = link.textContent = await playScene(state.open);
    link.target = "_blank";
    if (page) page.location = link.href;
    told.replaceChildren(`3D scene of episode ${state.open}: `, link);
  } catch (error) {
    page?.close();
    told.textContent = "";
    fail(error.message);
  }
}

const trim = (values) => { if (state.open != null && view.detail) change(state.open, values); };

const KEYS = {
  k: () => change(current(), {decision: "keep"}),
  d: () => change(current(), {decision: "drop"}),
  u: undo, j: next, t: askTags, n: askNote,
  "?": () => find("help").showModal(),
};
const EPISODE_KEYS = {
  " ": () => view.toggle(),
  "[": () => trim({first_frame: view.frame}),
  "]": () => trim({last_frame: view.frame}),
  "\\": () => trim({first_frame: null, last_frame: null}),
  c: () => { find("pin").ariaPressed = view.pin(); },
  s: showScene,
  Escape: close,
};

function onKey(event) {
  const typing = event.target.matches("input:not([type=range]):not([type=checkbox]), select") || document.querySelector("dialog[open]");
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === " " && event.target.matches("button")) return;
  let act = KEYS[event.key] ?? (state.open == null ? null : EPISODE_KEYS[event.key]);
  const step = {ArrowLeft: -1, ArrowRight: 1}[event.key];
  if (state.open != null && step) act = () => { view.pause(); view.seek(view.frame + step * (event.shiftKey ? 10 : 1)); };
  if (state.open == null && event.key === "Escape" && state.range) act = () => setRange(null);
  if (!act) return;
  event.preventDefault();
  act();
}

function fillSelects(keys) {
  const numeric = keys.filter((key) => state.rows.some((row) => typeof row[key] === "number"));
  const add = (id, names, chosen) => {
    find(id).replaceChildren(...names.map((key) => new Option(state.names[key] ?? key, key, false, key === chosen)));
  };
  add("sort", keys, "episode");
  const has = (...wanted) => wanted.find((key) => numeric.includes(key));
  add("plot-x", numeric, has("x_m", "episode"));
  add("plot-y", numeric, has("y_m", "margin", "frames"));
}

function setAxes() {
  const [x, y] = [find("plot-x").value, find("plot-y").value];
  find("x-name").textContent = state.names[x] ?? x;
  find("y-name").textContent = state.names[y] ?? y;
  plot.setData(state.rows, x, y);
  setRange(null);
}

function connect() {
  addEventListener("keydown", onKey);
  for (const id of ["search", "decision-filter", "sort", "descending"]) find(id).addEventListener("input", update);
  for (const id of ["plot-x", "plot-y"]) find(id).addEventListener("input", setAxes);
  for (const id of ["x-from", "x-to", "y-from", "y-to"]) find(id).addEventListener("change", readRange);
  const actions = {
    "clear-range": () => setRange(null), next, undo, back: close, pin: EPISODE_KEYS.c, scene: showScene, "help-button": KEYS["?"],
    "trim-first": EPISODE_KEYS["["], "trim-last": EPISODE_KEYS["]"], "trim-none": EPISODE_KEYS["\\"],
  };
  for (const [id, act] of Object.entries(actions)) find(id).addEventListener("click", act);
  for (const button of document.querySelectorAll("[data-decide]")) {
    button.addEventListener("click", () => change(state.open, {decision: button.dataset.decide}));
  }
  const takeOver = keepClaim((claim) => {
    find("other").hidden = claim !== "other";
    if (claim === "gone") fail("`yamsim review` has ended. Start it again, and reload this page.");
  });
  find("take-over").addEventListener("click", takeOver);
}

async function start() {
  const data = await get("/api/episodes");
  Object.assign(state, {
    names: data.names, rows: data.episodes, undecided: data.undecided, stale: new Set(data.stale),
    byNumber: new Map(data.episodes.map((row) => [row.episode, row])),
    decisions: new Map(Object.entries(data.decisions).map(([number, each]) => [Number(number), each])),
  });
  document.title = `${data.dataset}: review`;
  find("dataset").textContent = data.dataset;
  find("selection").textContent = data.selection;
  rankRows();
  picture = (episode, camera, frame) => `/picture/${episode}/${camera}/${frame}.jpg?${data.session}`;
  grid = new Grid(find("grid"), find("spacer"), {
    describe, strip: (episode) => `/strip/${episode}.jpg?${data.session}`, chosen: mark, opened: open,
  });
  plot = new Plot(find("plot"), {
    kind: kindOf, brushed: setRange, clicked: (episode) => grid.move(grid.order.indexOf(episode)),
  });
  view = new EpisodeView(picture, {failed: fail});
  fillSelects(Object.keys(data.episodes[0] ?? {episode: 0}));
  connect();
  setAxes();
  find("grid").focus();
  document.body.dataset.ready = "yes";
}

start().catch((error) => fail(error.message));
