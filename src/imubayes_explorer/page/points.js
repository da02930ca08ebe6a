// One reading: what is said of it where it is pointed at, and how a click selects it.

import { el, fill } from "./dom.js";
import { ask, latest } from "./net.js";
import { show, told, view } from "./state.js";

const box = el("div", { id: "reading", class: "reading", role: "status", hidden: true });
let waiting = 0;

export function hideReading() {
  clearTimeout(waiting);
  latest("point", async () => {}); // what is under way is given up
  box.hidden = true;
}

function facts(k, wanted) {
  return latest(wanted, (signal) => ask("point", { model: view.model, entry: told.points.entry[k] }, signal));
}

// The pointer rests for a moment: a reading is not told while the pointer crosses it.
export function tellReading(actions, place, k, left, top) {
  clearTimeout(waiting);
  if (k === null) {
    hideReading();
    return;
  }
  waiting = setTimeout(async () => {
    const found = await actions.attempt(() => facts(k, "point"));
    if (!found) return;
    fill(box, el("strong", {}, `${found.run}, row ${found.row}`),
      el("table", {}, el("tbody", {}, found.values.map(([label, words]) => el("tr", {}, el("td", { class: "left" }, label), el("td", {}, words))))));
    place.append(box);
    box.hidden = false;
    // Beside the reading, and whole within the window.
    const from = place.getBoundingClientRect(), wide = box.offsetWidth, x = from.left + left, y = from.top + top;
    const right = x + 14 + wide > innerWidth ? x - 14 - wide : x + 14;
    Object.assign(box.style, { left: `${Math.max(4, right)}px`, top: `${Math.max(4, Math.min(y + 14, innerHeight - box.offsetHeight - 4))}px` });
  }, 40);
}

export async function pickReading(actions, k, added) {
  const found = await actions.attempt(() => facts(k, "pick"));
  if (!found) return;
  const brush = { channels: [found.channel], runs: [found.run], rows: [found.row] };
  show({ brushes: added ? [...view.brushes, brush] : [brush] });
}
