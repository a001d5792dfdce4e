// All cells in one table, worst first: state, grade, last change, age, and the one action of each. What the poll tells is
// drawn at once; what the last run found is asked for when a run has ended.
import { get } from "./api.js";
import { ask } from "./ask.js";
import { gradeBadge, headline } from "./findings.js";
import { $, ago, button, clear, el, fill, sentence, when } from "./dom.js";
import { left } from "./progress.js";
import { say } from "./said.js";
import { ended } from "./spoken.js";
import { blind, busy, known, troubled } from "./store.js";
import { stop } from "./stop.js";
import { LANGUAGE, named, t } from "./texts.js";

const SHAPES = { trouble: "▲", moves: "►", waits: "◆", busy: "…", ready: "●" }, RANKS = Object.keys(SHAPES);
const GRADES = ["act", "watch", "none", "as_expected"];
const COLUMNS = ["cell", "state", "grade", "change", "age"];
/** @typedef {{ open: (cell: string) => void, begin: (cell: string, pressed: any) => any, accept: (run: Run) => any }} Acts */
/** @type {{ key: string, cells: Map<string, Cell>, order: string[], by: string, down: boolean, rank: string, text: string }} */
const fleet = { key: "", cells: new Map(), order: [], by: "state", down: true, rank: "", text: "" };

// A cell whose last run was stopped or failed is no cell in order until another one went well.
/** @param {Now} c */
export function rank(c) {
  if (c.moves) return "moves";
  if (["awaiting_arm", "awaiting_accept"].includes(c.state)) return "waits";
  if (busy(c) || (c.status === "unknown" && !troubled(c))) return "busy"; // its drives have not said yet
  return troubled(c) || c.status !== "ready" || c.grade === "act" ? "trouble" : "ready";
}
/** @param {Now} c */
export function stateText(c) {
  if (blind()) return t("ready.unknown");
  if (!busy(c) && troubled(c)) return named("state", c.state).split(":")[0];
  const text = c.status === "awaiting_accept" ? sentence(t("phase.awaiting_accept")) : named("state", c.status).split(":")[0];
  return c.moves ? `${text}, ${Math.round(100 * c.progress)} %` : text;
}

/** @param {Acts} acts */
export function showOverview(acts, fresh) {
  const key = known.cells.map((c) => `${c.cell} ${c.run} ${c.state}`).join();
  if ((fresh || fleet.key !== key) && !blind()) {
    fleet.key = key;
    get("/cells").then(({ cells }) => { fleet.cells = new Map(cells.map((c) => [c.id, c])); draw(acts); }, () => { fleet.key = ""; });
  }
  draw(acts, fresh);
}

const last = (c) => fleet.cells.get(c.cell)?.overview.last_run;
const gradeOf = (c) => (GRADES.includes(last(c)?.grade) ? last(c).grade : "none");
const news = (c) => fleet.cells.get(c.cell)?.overview.news;
// A result that waits has its age too.
const since = (c) => last(c)?.ended ?? (last(c) && last(c).id === c.run ? c.since : null);
// Upwards the first is the one to look at first: the worst state, the worst grade in it, the longest without a look.
const ORDERS = {
  cell: (a, b) => a.name.localeCompare(b.name, LANGUAGE, { numeric: true }),
  state: (a, b) => RANKS.indexOf(rank(a)) - RANKS.indexOf(rank(b)) || ORDERS.grade(a, b) || ORDERS.age(a, b),
  grade: (a, b) => GRADES.indexOf(gradeOf(a)) - GRADES.indexOf(gradeOf(b)),
  change: (a, b) => Number(Boolean(news(b))) - Number(Boolean(news(a))),
  age: (a, b) => Date.parse(since(a) ?? 0) - Date.parse(since(b) ?? 0),
};

/** @param {Acts} acts */
function draw(acts, fresh = false) {
  const body = $("fleet-rows"), cells = new Map(known.cells.map((c) => [c.cell, c]));
  heads(acts);
  filters(acts);
  // Nothing changes its place under a finger or a pointer, nor beside a question.
  if (fresh || fleet.order.length !== cells.size || !(body.matches(":hover, :focus-within") || body.querySelector("form"))) {
    const order = (a, b) => (fleet.down ? 1 : -1) * ORDERS[fleet.by](a, b) || ORDERS.cell(a, b);
    fleet.order = [...known.cells].sort(order).map((c) => c.cell);
  }
  const rows = new Map([...body.children].map((row) => [/** @type {HTMLElement} */ (row).dataset.cell, /** @type {any} */ (row)]));
  fleet.order.map((id) => cells.get(id)).filter(Boolean).forEach((c, i) => {
    const row = rows.get(c.cell) ?? emptyRow(c, acts);
    rows.delete(c.cell);
    drawRow(row, c, acts);
    if (body.children[i] !== row) body.insertBefore(row, body.children[i] ?? null);
  });
  for (const gone of rows.values()) gone.remove();
  $("fleet-none").hidden = [...body.children].some((row) => !(/** @type {HTMLElement} */ (row).hidden));
}

/** @param {Now} c
 * @param {Acts} acts */
function emptyRow(c, acts) {
  const cells = COLUMNS.map((name, i) => el("td", { class: name, "data-label": i > 1 ? t(`overview.${name}`) : null }));
  cells[0].append(button([c.name, c.simulated && el("small", {}, ` ${t("run.simulated")}`)], () => acts.open(c.cell), { class: "plain" }));
  return el("tr", { "data-cell": c.cell }, [...cells, el("td", { class: "act" }), el("td", { class: "halt" })]);
}

/** @param {Now} c
 * @param {Acts} acts */
function drawRow(row, c, acts) {
  const full = fleet.cells.get(c.cell), at = rank(c), [, state, grade, change, age, act, halt] = row.children;
  row.hidden = Boolean(fleet.rank && fleet.rank !== at) || !c.name.toLowerCase().includes(fleet.text);
  state.className = blind() ? "state" : `state ${at}`;
  write(state, [`${blind() ? "?" : SHAPES[at]} ${stateText(c)}`, ...left(c)].join(", "));
  write(age, since(c) ? ago(since(c)) : full && !busy(c) ? t("overview.never") : "");
  age.title = when(since(c));
  if (full && row.full !== full && !change.querySelector("form")) {
    row.full = full;
    fill(grade, last(c)?.verdict ? [gradeBadge(last(c).grade ?? "none")] : []);
    fill(change, [el("span", { title: told(full) }, told(full))]);
  }
  const wish = action(c, full), of = `${wish?.[0]} ${wish?.[2]} ${full?.last_identification?.id}`;
  if (act.of !== of) { // a new button where there is something else to do, and never another use of the one that is there
    act.of = of;
    fill(act, wish ? [button(t(wish[0]), (e) => wish[1](acts, e.currentTarget, change), { class: wish[2], "data-acts": "", "aria-label": `${t(wish[0])}: ${c.name}` })] : []);
  }
  if (busy(c) !== Boolean(halt.firstChild)) {
    if (busy(c)) fill(halt, [button(t("stop.button"), () => stop(c.cell), { class: "stop", "aria-label": t("stop.of", { cell: c.name }) })]);
    else clear(halt);
  }
}

// What changed; where nothing did, what is to be looked at; of a run that ended early why.
/** @param {Cell} cell */
function told({ last_identification: run, overview: { last_run: last, news } }) {
  if (!last) return "–";
  if (run?.id === last.id && run.error) return ended(run)[0];
  const serious = ["act", "watch"].includes(last.grade) && run?.id === last.id && run.summary ? headline(run.summary) : "";
  return say(news) || serious || t(news == null ? "overview.first" : "overview.unchanged");
}

// The one thing to do with a cell: words, work, looks. What has to be seen first is looked at, not done from here.
/** @param {Now} c
 * @param {Cell | undefined} full
 * @returns {[string, (acts: Acts, pressed: any, beside: any) => any, string] | null} */
function action(c, full) {
  const look = (looks) => /** @type {any} */ (["overview.look", (acts) => acts.open(c.cell), looks]), run = full?.last_identification;
  if (c.state === "awaiting_accept") {
    if (run?.id !== c.run) return null; // not yet known
    return run.untrusted || c.grade === "act" ? look("primary") : ["overview.accept", (acts, _, beside) => accept(acts, c, run, beside), "primary"];
  }
  if (busy(c)) return look(c.state === "awaiting_arm" ? "primary" : "");
  if (c.status !== "ready") return look("");
  return ["overview.start", (acts, pressed) => acts.begin(c.cell, pressed), ""];
}

/** @param {Acts} acts
 * @param {Now} c
 * @param {Run} run */
async function accept(acts, c, run, beside) {
  if (await ask(beside.firstElementChild, { title: t("overview.accept.title", { cell: c.name }), text: headline(run.summary), yes: t("result.accept") })) await acts.accept(run);
}

/** @param {Acts} acts */
function heads(acts) {
  const row = $("fleet-head");
  if (!row.children.length) {
    fill(row, [...COLUMNS.map((name) => el("th", { scope: "col", "data-by": name }, [button(t(`overview.${name}`), () => {
      Object.assign(fleet, { by: name, down: fleet.by !== name || !fleet.down });
      draw(acts, true);
    }, { class: "plain" })])), el("td"), el("td")]);
  }
  for (const head of row.querySelectorAll("th")) head.setAttribute("aria-sort", head.dataset.by !== fleet.by ? "none" : fleet.down ? "ascending" : "descending");
}

/** @param {Acts} acts */
function filters(acts) {
  const box = $("counts");
  if (!box.children.length) {
    const one = (name) => button("", () => { fleet.rank = fleet.rank === name ? "" : name; draw(acts, true); }, { "data-rank": name });
    fill(box, RANKS.map(one));
    $("fleet-search").addEventListener("input", () => { fleet.text = $("fleet-search").value.trim().toLowerCase(); draw(acts, true); });
  }
  for (const b of /** @type {any} */ (box.children)) {
    const name = b.dataset.rank, n = known.cells.filter((c) => rank(c) === name).length;
    write(b, `${SHAPES[name]} ${t(`overview.${name}`, { n })}`);
    b.hidden = blind() || (!n && fleet.rank !== name);
    b.setAttribute("aria-pressed", String(fleet.rank === name));
  }
}

function write(node, text) { if (node.textContent !== text) node.textContent = text; }
