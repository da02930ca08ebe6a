// The view of this window, which its address holds, and what the server has told; panels only read it.

const FIRST = { model: "", channel: "", x: "", y: "known", colour: "", only: [], brushes: [], ticked: [], tab: "models", between: null, after: false, beside: false, quantities: [] };

export const view = { ...FIRST, ...fromAddress() };
export const told = {
  session: null, kept: "", facts: null, points: null, selection: null, preview: null, hovered: "", fault: "", lost: false,
  dismissed: 0, folded: false, weighing: "", soFar: null, before: null,
};

export function atWork(task) {
  return ["waiting", "running", "cancelling"].includes(task.state);
}

const listeners = [];

export function onChange(listener) {
  listeners.push(listener);
}

// Changes of the view go through here, and into the address; panels are drawn anew from both.
export function show(changes, replace = false) {
  Object.assign(view, changes);
  const address = `#${encodeURIComponent(JSON.stringify(changed()))}`;
  if (address !== location.hash) history[replace ? "replaceState" : "pushState"](null, "", address);
  for (const listener of listeners) listener(Object.keys(changes), []);
}

export function tell(changes) {
  Object.assign(told, changes);
  for (const listener of listeners) listener([], Object.keys(changes));
}

// A step of the worker is news of its own line alone; what the panels show of a session is `kept`.
export function hear(session) {
  const kept = JSON.stringify([session.tree, session.commands, session.locks, session.tasks.filter(atWork).map((task) => task.number)]);
  tell({ session, lost: false, ...(kept === told.kept ? {} : { kept }) });
}

function changed() {
  return Object.fromEntries(Object.entries(view).filter(([name, value]) => JSON.stringify(value) !== JSON.stringify(FIRST[name])));
}

function fromAddress() {
  try {
    const read = JSON.parse(decodeURIComponent(location.hash.slice(1)) || "{}");
    return Object.fromEntries(Object.entries(read).filter(([name, value]) => name in FIRST && sameKind(value, FIRST[name])));
  } catch {
    return {};
  }
}

function sameKind(value, first) {
  return first === null ? value === null || Array.isArray(value) : typeof value === typeof first && Array.isArray(value) === Array.isArray(first);
}

window.addEventListener("hashchange", readAddress);
window.addEventListener("popstate", readAddress);

function readAddress() {
  Object.assign(view, FIRST, fromAddress());
  for (const listener of listeners) listener(Object.keys(FIRST), []);
}

// What a change does stands in the place of a preview, from the first second of the fit on.
export function previewed() {
  const refit = told.session?.tasks.find((task) => atWork(task) && task.kind === "change" && task.of === view.model);
  if (refit) return { effects: refit.adding, task: refit.number };
  if (told.facts?.stage !== "ready") return { effects: [] };
  // What was pointed at in the model before may be no cause of this one.
  const known = told.facts?.causes.some((cause) => cause.effect === told.hovered);
  const hovered = known && !view.ticked.includes(told.hovered) ? [told.hovered] : [];
  return { effects: [...view.ticked, ...hovered] };
}
