// Small charts as SVG: a history with its band, the last seconds before a stop. Each says what it shows.
import { el, estimate, fmt, when } from "./dom.js";
import { short, ticks } from "./plots.js";
import { t } from "./texts.js";

const WIDTH = 420, HEIGHT = 170, BOX = { left: 62, right: WIDTH - 10, top: 10, bottom: HEIGHT - 26 };

function scales(xs, ys) {
  const spread = (values) => {
    const low = Math.min(...values), high = Math.max(...values), pad = (high - low || Math.abs(high) || 1) * 0.08;
    return [low - pad, high + pad];
  };
  const [x0, x1] = spread(xs), [y0, y1] = spread(ys);
  return { x: (v) => BOX.left + (v - x0) / (x1 - x0) * (BOX.right - BOX.left), y: (v) => BOX.bottom - (v - y0) / (y1 - y0) * (BOX.bottom - BOX.top), y0, y1 };
}
function frame(alt, s, below) {
  const lines = ticks(s.y0, s.y1).flatMap((v) => [
    el("line", { x1: BOX.left, x2: BOX.right, y1: s.y(v), y2: s.y(v), class: "grid" }),
    el("text", { x: BOX.left - 6, y: s.y(v) + 4, "text-anchor": "end" }, short(v))]);
  const labels = below.map(([x, text, anchor]) => el("text", { x, y: HEIGHT - 7, "text-anchor": anchor }, text));
  return el("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": alt, class: "chart" }, [...lines, ...labels]);
}
const path = (points) => points.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ");

// `series` as of GET /cells/{cell}/series.
/** @param {Api["Series"]} series */
export function historyChart(name, series) {
  const all = series.points, there = all.filter((p) => p.value != null), unit = series.unit ?? "";
  if (!there.length) return null;
  const first = when(there[0].created), last = there.at(-1), values = there.map((p) => p.value);
  const absent = all.length - there.length ? ` (${t("history.absent", { n: all.length - there.length })})` : "";
  const alt = (there.length === 1 ? t("history.one", { name, first, value: estimate(last.value, last.std), unit })
    : t("history.alt", { name, n: there.length, first, last: when(last.created), value: estimate(last.value, last.std), unit, low: fmt(Math.min(...values)), high: fmt(Math.max(...values)) })) + absent;
  const at = (p) => new Date(p.created).getTime(), band = there.filter((p) => p.std != null);
  const s = scales(there.map(at), there.flatMap((p) => [p.value - 2 * (p.std ?? 0), p.value + 2 * (p.std ?? 0)]));
  const one = there.length === 1;
  const picture = frame(alt, s, one ? [[(BOX.left + BOX.right) / 2, first, "middle"]] : [[BOX.left, first, "start"], [BOX.right, when(last.created), "end"]]);
  if (band.length > 1) {
    picture.append(el("polygon", { class: "band", points: path([...band.map((p) => [s.x(at(p)), s.y(p.value + 2 * p.std)]), ...[...band].reverse().map((p) => [s.x(at(p)), s.y(p.value - 2 * p.std)])]) }));
  }
  // Where a cause was not there the line is broken.
  let piece = [];
  const pieces = [piece];
  for (const p of all) {
    if (p.value == null) { piece = []; pieces.push(piece); } else piece.push([s.x(at(p)), s.y(p.value)]);
  }
  for (const points of pieces) if (points.length > 1) picture.append(el("polyline", { class: "line", points: path(points) }));
  for (const p of there) {
    if (p.std != null) picture.append(el("line", { class: "bar", x1: s.x(at(p)), x2: s.x(at(p)), y1: s.y(p.value - 2 * p.std), y2: s.y(p.value + 2 * p.std) }));
    picture.append(el("circle", { class: p.accepted ? "accepted" : "other", cx: s.x(at(p)), cy: s.y(p.value), r: 5 }));
  }
  return { picture, alt };
}

// Position or torque of one axis before a stop, with the limit that it met.
export function traceChart(what, axis, seconds, values, unit, limit) {
  const beyond = limit != null && Math.max(...values.map(Math.abs)) > 0.6 * limit;
  const s = scales(seconds, beyond ? [...values, limit * Math.sign(values.at(-1) || 1)] : values);
  const alt = t("trace.alt", { what, axis, time: fmt(seconds.at(-1) - seconds[0], 2), from: fmt(Math.min(...values), 3), to: fmt(Math.max(...values), 3), end: fmt(values.at(-1), 3), unit,
    limit: limit == null ? "" : t("trace.alt.limit", { limit: `±${fmt(limit, 3)} ${unit}` }) });
  const picture = frame(alt, s, [[s.x(seconds[0]), short(Number(seconds[0].toFixed(2))), "middle"], [(BOX.left + BOX.right) / 2, t("trace.time"), "middle"], [s.x(seconds.at(-1)), short(Number(seconds.at(-1).toFixed(2))), "middle"]]);
  if (beyond) {
    const y = s.y(limit * Math.sign(values.at(-1) || 1));
    picture.append(el("line", { class: "limit", x1: BOX.left, x2: BOX.right, y1: y, y2: y }), el("text", { x: BOX.left + 6, y: y + (y < 40 ? 16 : -6), class: "limit" }, t("trace.limit")));
  }
  picture.append(el("polyline", { class: "line", points: path(values.map((v, i) => [s.x(seconds[i]), s.y(v)])) }));
  picture.append(el("circle", { class: "accepted", cx: s.x(seconds.at(-1)), cy: s.y(values.at(-1)), r: 5 }));
  return { picture, alt };
}
