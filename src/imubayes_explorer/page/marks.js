// Marks of readings on a panel: points by group and selection, the band of noise alone, dashes of a preview.

import { shape } from "./chart.js";
import { css, sign } from "./dom.js";
import { told, view } from "./state.js";

export function quantile(values, share) {
  const sorted = Float32Array.from(values).sort();
  return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : 0;
}

export function byGroup(points) {
  const groups = points.head.groups.map(() => []);
  for (let k = 0; k < points.head.count; k++) groups[points.group[k]].push(k);
  return groups;
}

export function drawPoints(context, at, points, y, faint) {
  const size = (points.head.count > 4000 ? 1.3 : points.head.count > 800 ? 2 : 2.8) * at.ratio;
  const selecting = told.selection?.n > 0 && view.brushes.length > 0;
  for (const chosen of selecting ? [false, true] : [null]) {
    byGroup(points).forEach((members, place) => {
      const { colour, shape: kind } = sign(place);
      context.beginPath();
      for (const k of members) if (chosen === null || Boolean(points.marked[k]) === chosen) shape(context, kind, at.x(points.x[k]), at.y(y[k]), size);
      context.globalAlpha = chosen === false ? 0.28 : faint ? 0.4 : 0.9;
      context.fillStyle = colour;
      context.fill();
      if (chosen) {
        context.strokeStyle = css("--marked");
        context.lineWidth = at.ratio;
        context.stroke();
      }
    });
  }
  context.globalAlpha = 1;
}

// Of noise alone 95 % of the residuals lie in the band.
export function drawBand(context, at, points) {
  const sd = quantile(points.sd, 0.5), { box } = at;
  context.fillStyle = css("--band");
  context.fillRect(box.left, at.y(sd), box.width, at.y(-sd) - at.y(sd));
  context.fillStyle = css("--quiet");
  context.fillRect(box.left, at.y(0), box.width, at.ratio);
}

export function dashes(context, at, points, y) {
  context.strokeStyle = css("--preview");
  context.lineWidth = 2.2 * at.ratio;
  context.beginPath();
  for (let k = 0; k < points.head.count; k++) {
    const x = at.x(points.x[k]), height = at.y(y[k]);
    context.moveTo(x - 5 * at.ratio, height);
    context.lineTo(x + 5 * at.ratio, height);
  }
  context.stroke();
}
