// Elements and texts. Text only ever goes in as text: names come from configs and uploads.
import { LANGUAGE, t } from "./texts.js";

/** @returns {Control} */
export const $ = (id) => /** @type {any} */ (document.getElementById(id));
/** @param {string} selector
 * @returns {Control[]} */
export const $$ = (selector) => /** @type {any} */ ([...document.querySelectorAll(selector)]);
const SVG = "http://www.w3.org/2000/svg";
const SHAPES = new Set(["svg", "g", "path", "line", "circle", "text", "title", "polygon", "polyline", "rect"]);
// What a person reads motion in, with its factor, by the unit of the cell.
/** @type {Record<string, [string, number]>} */
export const MOTION = { rad: ["°", 180 / Math.PI], m: ["mm", 1000] };
/** @param {any} children */
export function el(name, attributes = {}, children = []) {
  const node = SHAPES.has(name) ? document.createElementNS(SVG, name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "boolean") node[key] = value;
    else if (value != null) node.setAttribute(key, value);
  }
  node.append(...[children].flat().filter((c) => c != null && c !== false));
  return node;
}
export const clear = (node) => node.replaceChildren();
export const fill = (node, children) => node.replaceChildren(...children);
export function button(text, work, attributes = {}) {
  const made = el("button", { type: "button", ...attributes }, text);
  made.addEventListener("click", work);
  return made;
}
export function row(kind, cells, classes = {}) {
  return el("tr", {}, cells.map((c, i) => el(kind, { class: classes[i] }, [c instanceof Node ? c : String(c ?? "")])));
}
// A table whose rows become blocks on a narrow screen: every cell carries its column's name.
export function table(target, head, rows) {
  const body = rows.map(({ cells, changed }) => el("tr", { class: changed ? "changed" : null },
    cells.map((c, i) => el("td", { "data-label": head[i] || null }, [c instanceof Node ? c : String(c ?? "")]))));
  const top = el("tr", {}, head.map((h) => (h ? el("th", { scope: "col" }, h) : el("td"))));
  fill(target, [el("thead", {}, [top]), el("tbody", {}, body)]);
}
export const pointed = (text) => text.replaceAll(".", t("number.point"));
export function fmt(value, digits = 4) {
  if (value == null || !Number.isFinite(value)) return "?";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) return pointed(value.toExponential(Math.max(digits - 1, 0)));
  return pointed(String(Number(value.toPrecision(digits))));
}
// A travel or a speed as the plan has it: in degrees or millimetres.
export function moved(value, unit, digits = 3) {
  const [shown, factor] = MOTION[unit] ?? [unit, 1];
  return `${fmt(value * factor, digits)}${shown === "°" ? "" : " "}${shown}`;
}
// A value to the digit that its standard deviation leaves.
export function estimate(value, std) {
  if (value == null) return "–";
  if (!(std > 0)) return fmt(value, 5);
  const digits = Math.min(Math.max(1 - Math.floor(Math.log10(std)), 0), 8);
  return `${pointed(value.toFixed(digits))} ± ${pointed(std.toFixed(digits))}`;
}
// The month in letters: 11/12/26 is two days, depending on who reads it.
// As the browser writes dates, where it speaks the language of the page.
const LOCALE = navigator.languages.find((l) => l.startsWith(LANGUAGE)) ?? LANGUAGE;
export const time = (text) => (text ? new Date(text).toLocaleString(LOCALE, { dateStyle: "medium", timeStyle: "medium" }) : "");
export const when = (text) => (text ? new Date(text).toLocaleString(LOCALE, { dateStyle: "medium", timeStyle: "short" }) : "");
const AGES = /** @type {[Intl.RelativeTimeFormatUnit, number][]} */ ([["day", 86400], ["hour", 3600], ["minute", 60]]);
const relative = new Intl.RelativeTimeFormat(LOCALE, { numeric: "auto" });
// "3 days ago".
export function ago(text) {
  const s = (Date.now() - Date.parse(text)) / 1000, [unit, size] = AGES.find(([, n]) => s >= n) ?? ["minute", 60];
  return relative.format(-Math.floor(Math.max(s, 0) / size), unit);
}
export const clock = (at) => new Date(at).toLocaleTimeString(LOCALE, { timeStyle: "medium" });
export const seconds = (n) => (n < 100 ? t("time.seconds", { n: Math.ceil(n) })
  : t("time.minutes", { m: Math.floor(Math.ceil(n) / 60), s: Math.ceil(n) % 60 }));
export const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);
export const typical = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

// What is wider than the screen is scrolled by keyboard too; what is not is no stop on the way to the next button.
const widths = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    const box = /** @type {HTMLElement} */ (target.closest(".scroll"));
    if (!box) continue; // it has left the page
    if (box.scrollWidth > box.clientWidth + 1) box.tabIndex = 0;
    else box.removeAttribute("tabindex");
  }
});
for (const box of document.querySelectorAll(".scroll")) {
  widths.observe(box);
  new MutationObserver(() => { for (const child of box.children) widths.observe(child); }).observe(box, { childList: true });
  for (const child of box.children) widths.observe(child);
}
