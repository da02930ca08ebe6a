// What the worker does, what it brought, and what went wrong, each with what to do next.

import { el, fill, minus } from "./dom.js";
import { atWork, tell, told, view } from "./state.js";

// Between two steps the seconds run on.
const began = new Map();

function secondsOf(task) {
  const known = began.get(task.number);
  if (!known || known.seconds !== task.seconds) began.set(task.number, { seconds: task.seconds, at: performance.now() });
  const { seconds, at } = began.get(task.number);
  return task.state === "waiting" ? 0 : seconds + (performance.now() - at) / 1000;
}

setInterval(() => {
  for (const task of told.lost ? [] : (told.session?.tasks ?? []).filter(atWork)) {
    const place = document.getElementById(`seconds-${task.number}`);
    if (place) place.textContent = `${secondsOf(task).toFixed(0)} s`;
  }
}, 1000);

export function drawTasks(place, actions) {
  const lines = [];
  if (told.lost) {
    lines.push(el("div", {}, el("span", { class: "fault", role: "alert" }, "The server has stopped. Accepted results are in their folders. Start `imubayes explore` again and open the address that it prints; this page keeps trying.")));
  }
  const tasks = told.session?.tasks ?? [];
  // What a server that is gone was doing has ended with it.
  if (!told.lost) lines.push(...tasks.filter(atWork).map((task) => progress(task, actions)));
  if (told.session?.opened.some((each) => each.id === view.model && each.replaced)) {
    lines.push(el("div", { id: "replaced" }, el("span", { class: "said", role: "alert" }, "The folder no longer contains the result that is shown: verdict, map, residuals and causes are those of the earlier result."),
      el("button", { class: "main", id: "reload", "data-key": "reload", onclick: actions.reload }, "show the result that is in the folder now")));
  }
  const last = tasks.filter((task) => !atWork(task)).at(-1);
  if (last && last.number > told.dismissed) lines.push(ended(last));
  if (told.fault) lines.push(el("div", {}, el("span", { class: "fault", role: "alert" }, told.fault), close(() => tell({ fault: "" }))));
  fill(place, lines.filter(Boolean));
}

function progress(task, actions) {
  const refit = task.kind === "change" && told.preview?.refitted ? told.preview.sentence : null;
  const late = told.preview?.task === task.number && !refit;
  return el("div", {}, el("progress", { "aria-label": task.what }),
    refit ? el("span", { class: "said", id: "refit-sentence" }, minus(refit)) : null,
    late ? el("span", { id: "late-sentence" }, task.adding.length ? "The points show the linear prediction; the residuals of this change come with its fit." : "The residuals of this change come with its fit.") : null,
    el("span", { class: refit ? "quiet" : "said" }, `${task.what}: ${task.state === "cancelling" ? "cancelling at the next step" : task.step || "waiting"} · `, el("span", { id: `seconds-${task.number}` }, `${secondsOf(task).toFixed(0)} s`)),
    task.lines.length && !refit ? el("span", { class: "said" }, minus(task.lines.join("\n"))) : null,
    task.kind === "open" ? null : el("button", { id: "cancel", "data-key": "cancel", disabled: task.state === "cancelling", onclick: () => actions.cancel(task.number) }, "cancel"));
}

function ended(task) {
  if (task.state === "failed") {
    return el("div", {}, el("span", { class: "fault", role: "alert" }, `${task.what} failed\n${task.issues.join("\n")}`), close(() => tell({ dismissed: task.number })));
  }
  const cancelled = `${task.what} was cancelled; ${task.lines.length ? "what it had written remains." : "nothing was written."}`;
  const said = task.state === "cancelled" ? [cancelled, ...task.lines] : task.lines;
  return said.length ? el("div", {}, el("span", { class: "said" }, minus(said.join("\n"))), close(() => tell({ dismissed: task.number }))) : null;
}

function close(act) {
  return el("button", { class: "plain", "aria-label": "dismiss", onclick: act }, "✕");
}
