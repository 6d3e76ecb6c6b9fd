// Line charts as SVG, small and quiet; what they show is also there as a table for those who cannot see them.

import { draw } from "./dom.js";
import { nice } from "./framing.js";
import { short } from "./words.js";

const MARGIN = { top: 14, right: 14, bottom: 40, left: 52 };

function ticks(lo, hi, about) {
  const step = nice((hi - lo) / about);
  const out = [];
  for (let i = Math.ceil(lo / step - 1e-9); i * step <= hi + step * 1e-6; i++) out.push(Number((i * step).toPrecision(10)));
  return out;
}

/**
 * A chart of `series` [{name, points: [[x, y]], dots}] with axes; `floor` and `ceiling` hold the y axis open.
 */
export function chart({ series, across, title, width = 640, height = 240, floor = null, ceiling = null, percent = false }) {
  const points = series.flatMap((s) => s.points);
  const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
  let x0 = Math.min(...xs), x1 = Math.max(...xs);
  if (x0 === x1) [x0, x1] = [x0 - 0.5, x1 + 0.5];
  let y0 = Math.min(...ys, floor ?? Infinity), y1 = Math.max(...ys, ceiling ?? -Infinity);
  if (y0 === y1) [y0, y1] = [y0 - 1, y1 + 1];
  if (ceiling === null) y1 += 0.06 * (y1 - y0);
  if (floor === null) y0 -= 0.06 * (y1 - y0);
  const x = (v) => MARGIN.left + ((v - x0) / (x1 - x0)) * (width - MARGIN.left - MARGIN.right);
  const y = (v) => height - MARGIN.bottom - ((v - y0) / (y1 - y0)) * (height - MARGIN.top - MARGIN.bottom);
  const label = (v) => (percent ? `${Math.round(100 * v)} %` : short(v));
  const svg = draw("svg.chart", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title });
  for (const v of ticks(y0, y1, 4)) {
    svg.append(
      draw("line.grid", { x1: MARGIN.left, x2: width - MARGIN.right, y1: y(v), y2: y(v) }),
      draw("text.tick", { x: MARGIN.left - 8, y: y(v) + 4, "text-anchor": "end" }, label(v)));
  }
  for (const v of ticks(x0, x1, Math.max(2, width / 110))) {
    if (Number.isInteger(v)) svg.append(draw("text.tick", { x: x(v), y: height - 22, "text-anchor": "middle" }, String(v)));
  }
  svg.append(draw("text.tick.axis", { x: width - MARGIN.right, y: height - 7, "text-anchor": "end" }, across));
  series.forEach((s, i) => {
    if (!s.points.length) return;
    const path = s.points.map(([a, b], j) => `${j ? "L" : "M"}${x(a).toFixed(1)} ${y(b).toFixed(1)}`).join("");
    svg.append(draw(`path.line.line-${i}`, { d: path }));
    if (s.dots !== false && s.points.length <= 60) {
      for (const [a, b] of s.points) svg.append(draw(`circle.dot.line-${i}`, { cx: x(a).toFixed(1), cy: y(b).toFixed(1), r: 2.6 }));
    }
    const [a, b] = s.points.at(-1);
    svg.append(draw(`circle.dot.last.line-${i}`, { cx: x(a).toFixed(1), cy: y(b).toFixed(1), r: 4.5 }));
  });
  return svg;
}
