// What hues and shapes mean; a click shows what it is on alone.

import { el, fill, sign } from "./dom.js";
import { show, told, view } from "./state.js";

const MOST_NAMED = 14;

function runsOf(name) {
  if (!told.facts) return [];
  const { runs, labels } = told.facts, own = labels.find((each) => each.by === view.colour)?.labels ?? runs;
  return runs.filter((_, place) => own[place] === name);
}

export function drawLegend(groups) {
  const named = groups.slice(0, MOST_NAMED).map((name, place) => {
    const { colour, shape: kind } = sign(place);
    const mark = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    mark.setAttribute("width", 11);
    mark.setAttribute("height", 11);
    const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    const paths = { circle: "M1.5 5.5a4 4 0 1 0 8 0a4 4 0 1 0 -8 0", square: "M2 2h7v7h-7z", triangle: "M5.5 1L10 9.5H1z", diamond: "M5.5 .5L10.5 5.5L5.5 10.5L.5 5.5z", down: "M5.5 10L1 1.5H10z", cross: "M4 .5h3v3.5h3.5v3h-3.5v3.5h-3v-3.5h-3.5v-3h3.5z" };
    path.setAttribute("d", paths[kind]);
    path.setAttribute("fill", colour);
    mark.append(path);
    const runs = runsOf(name), alone = runs.length === view.only.length && runs.every((run) => view.only.includes(run));
    return el("button", { class: `plain ${alone ? "alone" : ""}`, "data-key": `legend-${name}`, "aria-pressed": String(alone), title: alone ? "show all runs" : `show ${name} alone`, onclick: () => show({ only: alone ? [] : runs }) }, mark, " ", name);
  });
  if (groups.length > MOST_NAMED) named.push(el("span", { class: "quiet" }, `and ${groups.length - MOST_NAMED} more`));
  if (told.points.head.of > told.points.head.count) {
    named.push(el("span", { class: "quiet" }, `${told.points.head.count} extremes of ${told.points.head.of} readings`));
  }
  fill(document.getElementById("legend"), named);
}
