// All cells at a glance, worst first, as the poll tells; what the last run found is asked for when a run has ended.
import { get } from "./api.js";
import { gradeBadge, headline, spokenHeadline } from "./findings.js";
import { $, button, el, fill, sentence, when } from "./dom.js";
import { blind, busy, known, troubled } from "./store.js";
import { stop } from "./stop.js";
import { named, t } from "./texts.js";

const SHAPES = { trouble: "▲", moves: "►", waits: "◆", busy: "…", ready: "●" }, RANKS = Object.keys(SHAPES);
const found = { key: "", cells: new Map(), order: [] };

// Worst first. A cell whose last run was stopped or failed is no cell in order until another one went well.
/** @param {Now} c */
export function rank(c) {
  if (c.moves) return "moves";
  if (["awaiting_arm", "awaiting_accept"].includes(c.state)) return "waits";
  if (busy(c)) return "busy";
  return troubled(c) || c.status !== "ready" || c.grade === "act" ? "trouble" : "ready";
}
/** @param {Now} c */
export function stateText(c) {
  if (blind()) return t("ready.unknown");
  if (!busy(c) && troubled(c)) return named("state", c.state).split(":")[0];
  const text = c.status === "awaiting_accept" ? sentence(t("phase.awaiting_accept")) : named("state", c.status).split(":")[0];
  return c.moves ? `${text}, ${Math.round(100 * c.progress)} %` : text;
}

// The last run in the page's language, where it is told in full; else the service's own sentences.
/** @param {Cell} cell */
function said({ last_identification: full, overview: { last_run: last } }) {
  const same = full && full.id === last?.id ? full : null, summary = same?.summary;
  const text = summary ? headline(summary) : same?.stopped?.reason ?? last?.headline;
  return [
    last ? el("p", {}, [el("small", { class: "quiet" }, t("overview.last", { time: when(last.ended ?? full?.started ?? full?.created) })), " ", last.grade && gradeBadge(last.grade)]) : el("p", { class: "quiet" }, t("overview.never")),
    text && el("p", { lang: summary ? spokenHeadline(summary) : "en" }, text),
  ];
}

export function showOverview(open, fresh) {
  const key = known.cells.map((c) => `${c.cell} ${c.run} ${c.state}`).join();
  if ((fresh || found.key !== key) && !blind()) {
    found.key = key;
    get("/cells").then(({ cells }) => { found.cells = new Map(cells.map((c) => [c.id, c])); draw(open); }, () => { found.key = ""; });
  }
  draw(open, fresh);
}

function draw(open, fresh) {
  const box = $("cells"), cells = new Map(known.cells.map((c) => [c.cell, c])), counts = RANKS.map((r) => [r, known.cells.filter((c) => rank(c) === r).length]);
  $("counts").textContent = blind() ? "" : counts.filter(([, n]) => n).map(([r, n]) => `${SHAPES[r]} ${t(`overview.${r}`, { n })}`).join("   ");
  // Nothing changes its place under a finger or a pointer.
  if (fresh || found.order.length !== cells.size || !box.matches(":hover, :focus-within")) {
    found.order = [...known.cells].sort((a, b) => RANKS.indexOf(rank(a)) - RANKS.indexOf(rank(b))).map((c) => c.cell);
  }
  const cards = new Map([...box.children].map((card) => [/** @type {HTMLElement} */ (card).dataset.cell, /** @type {any} */ (card)]));
  for (const c of found.order.map((id) => cells.get(id)).filter(Boolean)) {
    const card = cards.get(c.cell) ?? el("article", { class: "card", "data-cell": c.cell }, [
      el("h3", {}, [c.name, c.simulated && el("small", { class: "quiet" }, ` ${t("run.simulated")}`)]), el("p"), el("div"),
      el("p", { class: "actions" }, [button(t("overview.open", { cell: c.name }), () => open(c.cell)), button(t("stop.of", { cell: c.name }), () => stop(c.cell), { class: "stop" })])]);
    cards.delete(c.cell);
    const [, state, facts] = card.children, full = found.cells.get(c.cell);
    state.className = blind() ? "state" : `state ${rank(c)}`;
    state.textContent = `${blind() ? "?" : SHAPES[rank(c)]} ${stateText(c)}`;
    if (full && card.full !== full) { card.full = full; fill(facts, said(full).filter(Boolean)); }
    if (box.children[found.order.indexOf(c.cell)] !== card) box.insertBefore(card, box.children[found.order.indexOf(c.cell)] ?? null);
  }
  for (const gone of cards.values()) gone.remove();
}
