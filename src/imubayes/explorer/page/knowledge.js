// What the runs determined, what they did not, and the run that would.

import { digits, el, fill } from "./dom.js";
import { told } from "./state.js";

export function drawKnowledge(panel) {
  const known = told.facts?.knowledge;
  fill(panel, known ? el("p", {}, digits(0)) : el("p", { class: "quiet" }, "–"));
}
