// Elements and texts. Text only ever goes in as text: names come from configs and uploads.
export function el(name, attributes = {}, children = []) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "boolean") node[key] = value;
    else if (value != null) node.setAttribute(key, value);
  }
  node.append(...[children].flat().filter((c) => c != null && c !== false));
  return node;
}
export const clear = (node) => node.replaceChildren();
export const fill = (node, children) => node.replaceChildren(...children);
export function row(kind, cells, classes = {}) {
  return el("tr", {}, cells.map((c, i) => el(kind, { class: classes[i] }, [c instanceof Node ? c : String(c ?? "")])));
}
// A table whose rows become blocks on a narrow screen: every cell carries its column's name.
export function table(target, head, rows) {
  const body = rows.map(({ cells, changed }) => el("tr", { class: changed ? "changed" : null },
    cells.map((c, i) => el("td", { "data-label": head[i] || null }, [c instanceof Node ? c : String(c ?? "")]))));
  fill(target, [el("thead", {}, [row("th", head)]), el("tbody", {}, body)]);
  target.classList.add("stacks");
}
export function fmt(value, digits = 4) {
  if (value == null || !Number.isFinite(value)) return "?";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) return value.toExponential(Math.max(digits - 1, 0));
  return String(Number(value.toPrecision(digits)));
}
// A value to the digit that its standard deviation leaves.
export function estimate(value, std) {
  if (value == null) return "–";
  if (!(std > 0)) return fmt(value, 5);
  const digits = Math.min(Math.max(1 - Math.floor(Math.log10(std)), 0), 8);
  return `${value.toFixed(digits)} ± ${std.toFixed(digits)}`;
}
export const time = (text) => (text ? new Date(text).toLocaleString([], { dateStyle: "medium", timeStyle: "medium" }) : "");
