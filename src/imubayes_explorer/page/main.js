// The page: what changes leads to what is asked, and what is told leads to what is drawn. State flows one way.

import { asideDialog, drawBelow, drawTab, noteDialog, parentOf } from "./below.js";
import { loadBefore } from "./beside.js";
import { drawCauses, drawSoFar, tellWeighing } from "./causes.js";
import { el, fill } from "./dom.js";
import { firstAbscissa, firstColour, firstModel } from "./first.js";
import { formulaDialog } from "./formula.js";
import { helpDialog, listenToKeys } from "./keys.js";
import { drawMap } from "./map.js";
import { ask, latest, listen, points, text } from "./net.js";
import { drawCharts, drawControls, drawShape, focusRuns, makeCharts, picture, restyle, zoomToSelection } from "./panels.js";
import { atWork, hear, onChange, previewed, show, tell, told, view } from "./state.js";
import { drawTasks } from "./tasks.js";
import { tour } from "./tour.js";
import { drawVerdict, fold } from "./verdict.js";

const place = (name) => document.getElementById(name);
const dialog = place("dialog");
const RESIDUALS = ["known", "input", "fitted"];

// What goes wrong is told on the page.
async function attempt(work, refused = () => {}) {
  try {
    return await work();
  } catch (error) {
    refused();
    tell({ fault: error.issues ? error.issues.join("\n") : `internal error of the page: ${error.message}` });
    return undefined;
  }
}

const download = (name, made) => attempt(async () => {
  el("a", { href: URL.createObjectURL(made ? await made() : new Blob([await text(name)])), download: name }).click();
});

const actions = {
  attempt,
  accept: () => view.ticked.length && actions.change({ add: view.ticked }),
  cancel: (task) => attempt(() => ask("cancel", { task })),
  select: (model) => attempt(async () => hear(await ask("select", { model }))),
  lock: (effect, lock) => attempt(async () => {
    hear(await ask("lock", { effect, lock }));
    await select();
  }),
  note: (line) => noteDialog(dialog, line, (name, note) => attempt(async () => hear(await ask("note", { model: line.id, name, note })))),
  aside: () => view.brushes.length && asideDialog(dialog, told.selection?.n ?? 0, (reason) => actions.change({ aside: view.brushes, reason })),
  change: (wanted) => attempt(() => ask("change", { model: view.model, ...wanted })),
  undo: () => attempt(async () => {
    const before = parentOf(view.model);
    if (!before) return;
    hear(await ask("select", { model: before }));
    show({ model: before, ticked: [] });
  }),
  reload: () => attempt(async () => {
    told.facts = null;
    asked = "";
    hear(await ask("reload", { model: view.model }));
    tell({ facts: null });
  }),
  export: () => download("model.toml"),
  save: () => download("session.html"),
  picture: (kind) => download(`${view.channel}.${kind}`, () => picture(kind)),
  script: () => download("script.sh"),
  formula: (channel, drawn = null) => attempt(async () => {
    const found = await ask("formula", { model: view.model, channel, drawn });
    formulaDialog(dialog, channel, found, () => actions.change({ formula_of: channel, drawn }));
  }),
  draw: () => told.points && drawShape((drawn) => actions.formula(view.channel, drawn)),
  copy: () => attempt(async () => navigator.clipboard.writeText(await text("script.sh"))),
};

// ---- what is asked ----

// What the page chose by itself: it chooses again once the diagnosis says what the residual depends on.
let chosen = { model: "", x: "" };

async function open() {
  const facts = await attempt(() => latest("model", (signal) => ask("model", { model: view.model }, signal)));
  if (!facts || facts.id !== view.model) return;
  const own = chosen.model === facts.id && chosen.x === view.x && !view.brushes.length && !view.between;
  const mine = facts.abscissae.some((axis) => axis.name === view.x) && !own;
  const worst = facts.cells.reduce((one, other) => (other.chi2 / other.n > one.chi2 / one.n ? other : one), facts.cells[0]);
  const here = {
    channel: facts.channels.includes(view.channel) ? view.channel : worst.channel,
    x: mine ? view.x : firstAbscissa(facts),
    colour: facts.labels.some(({ by }) => by === view.colour) ? view.colour : firstColour(facts),
    ticked: facts.stage === "read" ? view.ticked : view.ticked.filter((effect) => facts.causes.some((cause) => cause.effect === effect)),
  };
  chosen = mine ? { model: "", x: "" } : { model: facts.id, x: here.x };
  told.facts = facts;
  show(here, true);
  tell({ facts });
  await Promise.all([select(), preview(), load(true)]);
}

async function load(moving = false) {
  if (!told.facts || told.facts.id !== view.model) return;
  const wanted = {
    model: view.model, channel: view.channel, runs: view.only, x: view.x, y: view.y, colour: view.colour,
    between: view.between, brushes: view.brushes, ...previewed(),
  };
  const found = await attempt(() => latest("points", (signal) => points(wanted, signal)));
  if (!found) return;
  if (found.head.refitted) Object.assign(found, { held: found.y, y: found.after, predicted: found.curve });
  const before = moving || found.head.refitted !== told.points?.head.refitted ? told.points : null;
  told.points = found;
  drawCharts(before);
  if (await loadBefore(wanted, attempt)) drawCharts();
}

async function select() {
  if (!told.facts || told.facts.id !== view.model) return;
  if (!view.brushes.length) {
    tell({ selection: null });
    return;
  }
  const selection = await attempt(() => latest("selection", (signal) => ask("selection", { model: view.model, brushes: view.brushes }, signal)));
  if (selection) tell({ selection });
}

async function preview() {
  if (!told.facts || told.facts.id !== view.model) return;
  const wanted = previewed();
  if (!wanted.effects.length && !wanted.task) {
    tell({ preview: null });
    return;
  }
  const found = await attempt(() => latest("preview", (signal) => ask("preview", { model: view.model, ...wanted }, signal)), () => tell({ preview: null }));
  if (found) tell({ preview: found });
}

// ---- what leads to what ----

const any = (names, ...wanted) => names.some((name) => wanted.includes(name));

onChange((seen, heard) => {
  if (any(seen, "model") && view.model) {
    if (told.facts?.id !== view.model) told.facts = null;
    open();
  } else if (told.facts) {
    if (any(seen, "brushes")) select();
    if (any(seen, "ticked") || any(heard, "hovered", "kept")) preview();
    if (any(seen, "channel", "x", "y", "colour", "only", "brushes", "ticked", "between", "beside") || any(heard, "hovered", "kept")) load();
    if (any(seen, "after") || any(heard, "selection", "preview")) drawCharts();
  }
  draw(seen, heard);
});

function draw(seen, heard) {
  if (any(heard, "facts", "lost", "folded") || any(seen, "model")) drawVerdict(place("verdict"));
  if (any(heard, "facts", "preview") || any(seen, "brushes", "channel", "model")) drawMap(place("map"));
  if (any(heard, "facts", "selection", "preview", "kept") || any(seen, "brushes", "ticked", "model")) drawCauses(place("causes"), actions);
  if (any(heard, "weighing")) tellWeighing();
  if (any(heard, "soFar")) drawSoFar();
  if (any(heard, "facts", "kept") || any(seen, "tab", "model")) drawBelow(place("below"), actions);
  drawTab(actions, seen, heard);
  if (any(heard, "facts", "selection") || any(seen, "channel", "x", "y", "colour", "only", "after", "between", "beside")) drawControls(actions);
  if (any(heard, "session", "fault", "lost", "dismissed", "preview")) drawTasks(place("notice"), actions);
}

let asked = "";

// A change that was taken is followed by every window that shows the model it was made from.
function onState(session) {
  const last = told.session;
  hear(session);
  const known = new Set((last?.tasks ?? []).filter((task) => task.made).map((task) => task.number));
  for (const task of session.tasks) {
    const fresh = last && task.made && !known.has(task.number);
    if (fresh && task.of === view.model && task.made !== view.model) show({ model: task.made, ticked: [] });
  }
  const now = session.opened.find((each) => each.id === view.model), key = now && `${now.id} ${now.stage} ${now.identity}`;
  const weighing = told.facts?.stage === "ready" ? "" : session.tasks.find((task) => atWork(task) && (task.of === view.model || task.made === view.model))?.step ?? "";
  if (weighing !== told.weighing) tell({ weighing });
  if (now?.so_far?.hypotheses !== told.soFar?.hypotheses) tell({ soFar: now?.so_far ?? null });
  if (now && asked !== key && (told.facts?.id !== now.id || told.facts.stage !== now.stage || told.facts.identity !== now.identity)) {
    asked = key;
    open();
  }
  if (told.before?.waiting && session.opened.some((each) => each.id === told.before.waiting)) load();
  const there = session.tree.some((line) => line.id === view.model);
  if (!there && session.tree.length) show({ model: firstModel(session).id }, true);
  else if (!told.facts && there && !session.tasks.some(atWork) && !last) open();
}

// ---- tools and keys ----

function next(list, now, step) {
  return list[(list.indexOf(now) + step + list.length) % list.length];
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  try {
    localStorage.setItem("imubayes-theme", name);
  } catch { /* private windows forget it */ }
}

function switchTheme() {
  theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  drawMap(place("map"));
  restyle();
}

function tools() {
  fill(place("tools"),
    el("button", { id: "open-tour", onclick: tour }, "tour"),
    el("button", { id: "open-help", onclick: () => helpDialog(dialog), title: "key ?" }, "keys"),
    el("button", { id: "open-theme", onclick: switchTheme, title: "key d" }, "light / dark"));
}

const channels = () => told.facts?.channels ?? [view.channel], covariates = () => told.facts?.abscissae.map((axis) => axis.name) ?? [view.x];
const turnX = (step) => show({ x: next(covariates(), view.x, step), between: null, brushes: view.brushes.filter((brush) => !brush.x) });

listenToKeys({
  "?": () => helpDialog(dialog), t: tour, d: switchTheme,
  h: fold, m: () => (place("map").querySelector(".cell.marked") ?? place("map").querySelector(".cell"))?.focus(), r: () => place("residuals").focus(),
  c: () => place("causes").querySelector(".tick:not(:disabled)")?.focus(), a: actions.accept, u: actions.undo, e: actions.export, g: () => actions.picture("svg"), G: () => actions.picture("png"), s: actions.aside,
  x: () => told.session?.tasks.filter(atWork).forEach((task) => actions.cancel(task.number)),
  n: () => show({ channel: next(channels(), view.channel, 1) }), N: () => show({ channel: next(channels(), view.channel, -1) }),
  v: () => turnX(1), V: () => turnX(-1), y: () => show({ y: next(RESIDUALS, view.y, 1) }), o: focusRuns,
  f: () => told.facts && actions.formula(view.channel), w: actions.draw, p: () => show({ after: !view.after }), b: () => show({ beside: !view.beside }), z: zoomToSelection, Z: () => show({ between: null }),
  Escape: () => show(view.brushes.length ? { brushes: [], only: [] } : { ticked: [] }),
  1: () => show({ tab: "models" }), 2: () => show({ tab: "estimates" }), 3: () => show({ tab: "knowledge" }), 4: () => show({ tab: "commands" }),
});

let wanted = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
try {
  wanted = localStorage.getItem("imubayes-theme") ?? wanted;
} catch { /* as the system has it */ }
theme(wanted);
try {
  told.folded = localStorage.getItem("imubayes-folded") === "yes";
} catch { /* unfolded */ }
tools();
makeCharts(place("charts"), actions);
drawVerdict(place("verdict"));
listen(onState, () => tell({ lost: true }), () => tell({ lost: false }));
