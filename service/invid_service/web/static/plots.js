// Pictures: curves with uPlot, clouds on a canvas. Colours differ in lightness, lines also in dash and marker.
// Each says in `alt` what it shows.
import { $$ } from "./dom.js";
import { t } from "./texts.js";

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
// A turned tablet or a resized window draws everything anew.
const drawn = new Map();
let pending = 0;
function anew() {
  clearTimeout(pending);
  pending = setTimeout(redraw, 150);
}
export function redraw() {
  for (const [target, draw] of drawn) target.isConnected ? draw() : drawn.delete(target);
}
window.addEventListener("resize", anew);
// At dusk a tablet goes dark by itself: black lines on black would be left.
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", anew);
// On paper: light colours, and everything unfolded.
let unfolded = [];
window.addEventListener("beforeprint", () => {
  document.documentElement.dataset.print = "";
  unfolded = $$("#result-card details:not([open])");
  for (const d of unfolded) d.open = true;
  redraw();
});
window.addEventListener("afterprint", () => {
  delete document.documentElement.dataset.print;
  for (const d of unfolded) d.open = false;
  redraw();
});
const DASHES = [[], [10, 5], [3, 4]];

function axes(x, y) {
  const base = { stroke: colour("--ink"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { stroke: colour("--grid") }, font: "14px system-ui", labelFont: "14px system-ui", labelSize: 28 };
  const plain = (u, ticks) => ticks.map((v) => (v == null ? "" : short(v)));
  const decades = (u, ticks) => ticks.map((v) => (v == null || !round(v) ? "" : short(v)));
  return [{ ...base, label: x, values: decades, filter: (u, splits) => splits }, { ...base, label: y, size: 78, values: plain }];
}
// 1, 2 or 5 times a power of ten: what a logarithmic axis is labelled at.
function round(v) { const mantissa = v / 10 ** Math.floor(Math.log10(v) + 1e-9); return [1, 2, 5, 10].some((m) => Math.abs(mantissa - m) < 1e-6); }

// One x for all series: values of each looked up at its own points, null elsewhere.
function joined(series) {
  const all = [...new Set(series.flatMap((s) => s.x))].sort((a, b) => a - b);
  const at = new Map(all.map((v, i) => [v, i]));
  const columns = series.map((s) => {
    const column = new Array(all.length).fill(undefined);
    s.x.forEach((v, i) => { column[at.get(v)] = s.y[i] > 0 ? s.y[i] : null; });
    return column;
  });
  return [all, ...columns];
}

export function curves(target, picture) {
  drawn.set(target, () => drawCurves(target, picture));
  return drawCurves(target, picture);
}

function drawCurves(target, { x, y, series, peaks = [], alt = "" }) {
  target.replaceChildren();
  target.setAttribute("role", "img");
  target.setAttribute("aria-label", alt || `${y}, ${x}: ${series.map((s) => s.label).join(", ")}`);
  const shown = series.filter((s) => s.x.length);
  if (!shown.length) return null;
  const data = joined(shown);
  const options = {
    width: Math.max(280, target.clientWidth), height: Math.min(420, Math.max(300, Math.round(target.clientWidth * 0.5))),
    scales: { x: { time: false, distr: 3, range: (u, low, high) => [low * 0.97, high * 1.03] }, y: { distr: 3 } },
    axes: axes(x, y), legend: { live: false }, cursor: { drag: { x: true, y: false } },
    series: [{}, ...shown.map((s, k) => ({
      label: s.label, stroke: colour(s.colour), width: s.points ? 0 : s.width ?? 2.5, dash: s.points ? undefined : DASHES[s.dash ?? k % 3], spanGaps: true,
      points: s.points ? { show: true, size: 6, stroke: colour(s.colour), fill: colour(s.colour) } : { show: false },
      paths: s.points ? () => null : undefined,
    }))],
    hooks: { draw: [(u) => labelPeaks(u, peaks)] },
  };
  return new uPlot(options, data, target);
}

function labelPeaks(u, peaks) {
  const c = u.ctx, ratio = window.devicePixelRatio || 1;
  c.save();
  c.fillStyle = colour("--ink"); c.strokeStyle = colour("--quiet"); c.setLineDash([2 * ratio, 4 * ratio]);
  c.font = `${13 * ratio}px system-ui`; c.textAlign = "center";
  const rows = [-Infinity, -Infinity, -Infinity, -Infinity];
  for (const f of peaks) {
    if (f < u.scales.x.min || f > u.scales.x.max) continue;
    const px = u.valToPos(f, "x", true), text = `${short(Number(f < 10 ? f.toFixed(2) : f.toFixed(1)))} Hz`, half = c.measureText(text).width / 2;
    const middle = Math.min(Math.max(px, u.bbox.left + half), u.bbox.left + u.bbox.width - half);
    // The first row with room; where there is none the line stays and the label goes.
    const row = rows.findIndex((right) => middle - half > right + 6 * ratio), top = u.bbox.top + (14 + 16 * Math.max(row, 0)) * ratio;
    c.beginPath(); c.moveTo(px, top + 4 * ratio); c.lineTo(px, u.bbox.top + u.bbox.height); c.stroke();
    if (row < 0) continue;
    rows[row] = middle + half;
    // A rim in the ground's colour: the peak itself runs through its label.
    c.save(); c.setLineDash([]); c.lineWidth = 6 * ratio; c.lineJoin = "round"; c.strokeStyle = colour("--card");
    c.strokeText(text, middle, top); c.restore();
    c.fillText(text, middle, top);
  }
  c.restore();
}

// Missing torque over what it depends on: dots; over them squares, the fitted cause in the same band, and the cause itself
// as a line where it is a curve over this quantity.
export function cloud(target, picture) {
  drawn.set(target, () => drawCloud(target, picture));
  drawCloud(target, picture);
}

function drawCloud(target, { x, y, fit, law, xLabel, yLabel, alt }) {
  target.replaceChildren();
  target.setAttribute("role", "img");
  target.setAttribute("aria-label", alt);
  const canvas = document.createElement("canvas"), ratio = window.devicePixelRatio || 1;
  const width = Math.max(280, target.clientWidth), height = Math.min(380, Math.max(260, width * 0.45));
  canvas.width = width * ratio; canvas.height = height * ratio;
  canvas.style.width = `${width}px`; canvas.style.height = `${height}px`;
  target.append(canvas);
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  const box = { left: 74, top: 12, right: width - 12, bottom: height - 48 };
  const ys = [y, fit?.y ?? [], law?.y ?? []].flat();
  const [x0, x1] = range(x), [y0, y1] = range(ys);
  const px = (v) => box.left + (v - x0) / (x1 - x0) * (box.right - box.left);
  const py = (v) => box.bottom - (v - y0) / (y1 - y0) * (box.bottom - box.top);
  c.font = "14px system-ui"; c.fillStyle = colour("--ink"); c.strokeStyle = colour("--grid");
  for (const v of ticks(x0, x1)) { line(c, px(v), box.top, px(v), box.bottom); c.textAlign = "center"; c.fillText(short(v), px(v), box.bottom + 18); }
  for (const v of ticks(y0, y1)) { line(c, box.left, py(v), box.right, py(v)); c.textAlign = "right"; c.fillText(short(v), box.left - 8, py(v) + 5); }
  c.textAlign = "center"; c.fillText(xLabel, (box.left + box.right) / 2, height - 8);
  c.save(); c.translate(16, (box.top + box.bottom) / 2); c.rotate(-Math.PI / 2); c.fillText(yLabel, 0, 0); c.restore();
  c.globalAlpha = 0.5; c.fillStyle = colour("--before");
  fit?.x.forEach((v, i) => c.fillRect(px(v) - 3, py(fit.y[i]) - 3, 6, 6));
  c.globalAlpha = 0.7; c.fillStyle = colour("--measured");
  x.forEach((v, i) => { c.beginPath(); c.arc(px(v), py(y[i]), 2, 0, 7); c.fill(); });
  c.globalAlpha = 1; c.strokeStyle = colour("--before"); c.lineWidth = 2.5; c.beginPath();
  law?.x.forEach((v, i) => (i ? c.lineTo(px(v), py(law.y[i])) : c.moveTo(px(v), py(law.y[i]))));
  c.stroke();
}
function line(c, ax, ay, bx, by) { c.beginPath(); c.moveTo(ax, ay); c.lineTo(bx, by); c.stroke(); }
function range(values) {
  const low = Math.min(...values), high = Math.max(...values), pad = (high - low || Math.abs(high) || 1) * 0.06;
  return [low - pad, high + pad];
}
export function ticks(low, high) {
  const raw = (high - low) / 5, power = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 5, 10].find((s) => s * power >= raw) * power, found = [];
  for (let v = Math.ceil(low / step) * step; v <= high + step * 1e-9; v += step) found.push(Math.abs(v) < step * 1e-9 ? 0 : v);
  return found;
}
export function short(v) {
  return (Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(1) : String(Number(v.toPrecision(4)))).replace(".", t("number.point"));
}
