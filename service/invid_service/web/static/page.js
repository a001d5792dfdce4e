// The technician's page: one cell, one button, what will move, progress, stop, then the result.
import { Problem, call, download, get, onKeyRefused, post, useKey } from "./api.js";
import { onVerify } from "./verify.js";
import { ask } from "./ask.js";
import { changed, forgetChanged, offerChanged } from "./changed.js";
import { why } from "./findings.js";
import { showHistory } from "./history.js";
import { showOverview, stateText } from "./overview.js";
import { showPlan } from "./plan.js";
import { redraw } from "./plots.js";
import { showProgress } from "./progress.js";
import { showDecision, showResult } from "./result.js";
import { ended, reasonItem, refused, whyNot } from "./spoken.js";
import { stop } from "./stop.js";
import { showStopped } from "./stopped.js";
import { blind, busy, find, known, look, onState, troubled } from "./store.js";
import { $, $$, clock, el, fill, fmt, moved, row, sentence, time } from "./dom.js";
import { choose, named, t } from "./texts.js";
import { who } from "./who.js";

const ENDED = ["succeeded", "failed", "cancelled", "stopped", "interrupted"];
const MOVING = ["running", "analysing", "queued", "checking"];
const READY_EVERY_MS = 3000;
// What a person chose to look at; everything else is what the service says. `opened`: a run; `dismissed`: the one of the
// cell that has been seen. `details` and `run` are fetched when what the poll tells of them changes.
/** @type {{ cell: string, opened: string, dismissed: string, details: Cell & { of: string }, run: Run, ready: Api["Readiness"], at: number }} */
const state = { cell: localStorage.getItem("invid-cell"), opened: null, dismissed: null, details: null, run: null, ready: null, at: 0 };

// Over every view and wherever the page is scrolled to: whoever pressed a button looks at that button.
function say(error) {
  const box = $("problem");
  box.hidden = false;
  box.dataset.gone = String(!(error instanceof Problem));
  fill(box, error instanceof Problem ? refused(error) : [t("page.unreachable")]);
}
const guarded = (work) => async (...given) => { $("problem").hidden = true; try { return await work(...given); } catch (error) { return say(error); } };

// --- stop: first of all, needs nothing but what is on the screen --------------------------------------
const stopNow = () => stop(ofAll() ? "" : state.cell ?? "");
$("stop").addEventListener("click", stopNow);
document.addEventListener("keydown", (e) => { if (e.key === "Escape") stopNow(); });

// --- everything drawn from what the service said last --------------------------------------------------
function draw(news) {
  const quiet = blind(), ids = known.cells.map((c) => c.cell).join();
  $("offline").hidden = !quiet;
  const since = quiet ? t("page.offline", { time: clock(known.heard), why: whyNot(known.failure) }) : "";
  if ($("offline").textContent !== since) $("offline").textContent = since;
  document.body.classList.toggle("blind", quiet);
  if (news && $("problem").dataset.gone === "true") $("problem").hidden = true;
  if (known.cells.length && !find(state.cell)) state.cell = known.cells[0].cell;
  if ($("cell").dataset.ids !== ids) {
    $("cell").dataset.ids = ids;
    fill($("cell"), known.cells.map((c) => el("option", { value: c.cell }, c.name)));
  }
  $("cell").value = state.cell;
  const c = find(state.cell), all = ofAll();
  $("stop-of").textContent = all ? t("stop.all_cells") : c?.name ?? "";
  const moving = known.cells.filter((other) => other.moves && (all || viewed() !== "work" || other !== c)).map((other) => `► ${other.name}: ${stateText(other)}`);
  $("moving").textContent = quiet ? "" : moving.join("; ");
  if (viewed() === "overview") showOverview(acts);
  buttons();
  if (quiet) { $("ready-title").className = ""; $("ready-title").textContent = t("ready.unknown"); }
  if (state.run) title();
  if (state.run && c && busy(c) && c.run === state.run.id) showProgress(c);
  if (news) follow(c);
}
onState(draw);
// What stands above the stop bar has to know how high its words make it.
new ResizeObserver(() => document.documentElement.style.setProperty("--stop-height", `${$("stopbar").offsetHeight}px`)).observe($("stopbar"));

// What changes something is pressed only where it is known what it meets.
function buttons() {
  for (const b of $$("[data-acts]")) b.disabled = blind() || b.dataset.pressed === "true" || (["prepare", "screen"].includes(b.id) && !state.ready?.can_start);
}

// Which run is to be seen: one in progress, whoever started it and whatever is open; then the one that a person opened; then
// the last one, where it waits for a decision or ended as it should not.
/** @param {Now} c */
function wanted(c) {
  if (busy(c)) state.opened = c.run;
  const calls = (c.state === "awaiting_accept" || troubled(c)) && c.run !== state.dismissed;
  return state.opened ?? (calls ? c.run : null);
}
/** @param {Now} c */
function follow(c) {
  if (!c) return;
  const id = wanted(c), { run } = state, of = `${c.cell} ${c.run} ${c.state}`;
  if (state.details?.of !== of) details(c.cell, of);
  if (!id) { if (run) show(null); } else if (run?.id !== id || (c.run === id ? run.state !== c.state : MOVING.includes(run.state))) fetchRun(id);
  if (!state.run && Date.now() - state.at > READY_EVERY_MS) refresh();
}

const once = new Set();
async function alone(name, work) {
  if (once.has(name)) return;
  once.add(name);
  try { await work(); } catch (error) { if (!(error instanceof Problem)) console.warn(error); /* the poll says so, and asks again */ } finally { once.delete(name); }
}
const fetchRun = (id) => alone(id, async () => {
  try {
    /** @type {Run} */
    const run = await get(`/identifications/${id}`);
    if (wanted(find(state.cell)) !== id) return;
    if (run.cell && run.cell !== state.cell) enter(run.cell, id);
    show(run);
  } catch (error) { if (error.status === 404 && state.opened === id) state.opened = null; throw error; }
});

// --- cell and readiness ------------------------------------------------------------------------------
function enter(cell, opened = null) {
  localStorage.setItem("invid-cell", cell);
  Object.assign(state, { cell, opened, dismissed: null, details: null });
  if (!opened) show(null);
  draw(true);
}
$("cell").addEventListener("change", () => { enter($("cell").value); if (viewed() === "history") setView("history"); });

const details = (id, of) => alone(`cell ${id}`, async () => {
  /** @type {Cell} */
  const cell = await get(`/cells/${id}`), same = state.details?.id === id;
  if (id !== state.cell) return;
  state.details = { ...cell, of };
  $("simulated").hidden = !cell.simulated;
  $("in-force").textContent = cell.model ? t("ready.in_force", { time: time(cell.model.accepted), by: cell.model.by }) : t("ready.no_model");
  $("screen").hidden = !cell.model; // nothing can have changed since none
  if (state.run) show(state.run);
  if (same) return;
  offerChanged(cell);
  $("strength").hidden = $("upload-cell-choice").hidden = false;
  fill($("axes"), cell.axes.map((a) => el("label", {}, [el("input", { type: "checkbox", name: "axis", value: a, checked: true }), el("b", {}, a)])));
  fill($("drives"), [el("table", {}, [
    row("th", ["axis", "node", "rated", "torque", "travel", "speed", "held"].map((h) => t(`drive.${h}`))),
    ...cell.drives.map((d, i) => {
      const l = cell.limits[i];
      return row("td", [d.axis, d.node_id, d.rated_torque ? `${fmt(d.rated_torque)} ${l.torque_unit}` : t("drive.from_drive"), `${fmt(l.torque)} ${l.torque_unit}`,
        `±${moved(l.position, l.position_unit)}`, `${moved(l.velocity, l.position_unit)}/s`, named("hold", d.hold)]);
    })])]);
});

const refresh = () => alone("ready", async () => {
  const cell = state.cell;
  /** @type {Api["Readiness"]} */
  const ready = await get(`/cells/${cell}/readiness`);
  if (cell === state.cell && !state.run) tellReady(ready);
});

function tellReady(ready) {
  Object.assign(state, { ready, at: Date.now() });
  const title = $("ready-title");
  const unasked = ready.notes.some((n) => n.code === "drives_not_asked");
  title.textContent = !ready.can_start ? t("ready.no") : unasked ? t("ready.unasked") : t("ready.yes");
  title.className = !ready.can_start ? "bad" : unasked ? "" : "good";
  fill($("reasons"), ready.reasons.map(reasonItem));
  fill($("ready-notes"), (ready.notes ?? []).map(reasonItem));
  $("check").hidden = !unasked && ![...ready.reasons, ...ready.notes].some((r) => r.seen); // remembered: the drives may say otherwise
  $("ready-card").hidden = $("start-card").hidden = false;
  buttons();
}
$("check").addEventListener("click", guarded(() => pressing($("check"), async () => {
  const cell = state.cell, ready = await post(`/cells/${cell}/check`, undefined, {}, 60000); // slow drives take their time
  if (cell === state.cell && !state.run) tellReady(ready);
})));

// --- start ----------------------------------------------------------------------------------------------
const unique = () => ({ "Idempotency-Key": `page-${Date.now()}-${Math.random().toString(36).slice(2)}` });
// Pressed twice is meant once.
async function pressing(button, work) {
  button.dataset.pressed = "true";
  buttons();
  try { return await work(); } finally { delete button.dataset.pressed; buttons(); }
}
const begin = (body, pressed) => pressing(pressed, async () => { opens(await post(`/cells/${state.cell}/identifications`, body, unique())); });
$("start-card").addEventListener("submit", guarded(async (event) => {
  event.preventDefault();
  const form = new FormData(event.target), axes = form.getAll("axis");
  if (!axes.length) { $("problem").hidden = false; fill($("problem"), [t("start.no_axis")]); return; }
  await begin({ mode: form.get("mode"), axes, ...(form.get("amplitude") === "gentler" ? { amplitude: "gentler" } : {}), ...changed() }, $("prepare"));
  forgetChanged();
}));
$("screen").addEventListener("click", guarded(async () => { await begin({ mode: "screen", ...changed() }, $("screen")); forgetChanged(); }));
onVerify({ guarded, verify: (tuned, pressed) => begin({ mode: "verify", tuned }, pressed) });
$("separate").addEventListener("click", guarded(() => begin({ mode: state.run.mode === "simulate" ? "simulate" : "full", separate: state.run.id }, $("separate"))));
$("analyse").addEventListener("click", guarded(() => pressing($("analyse"), async () => opens(await post(state.run.links.analysis, undefined, unique())))));
const again = guarded(({ amplitude }) => begin({ mode: state.run.mode, amplitude, ...(state.run.changed ? { changed: state.run.changed } : {}), ...(state.run.verifies ? { tuned: state.run.verifies } : state.run.separates ? { separate: state.run.separates } : { axes: state.run.axes }) }, $("stopped-do")));

// --- the run that is seen -----------------------------------------------------------------------------
/** @param {Run} run */
function opens(run) {
  state.opened = run.id;
  setView("work");
  show(run);
  look();
}

/** @param {Run} run */
function show(run) {
  const before = state.run, isNew = before?.id !== run?.id || before?.state !== run?.state;
  state.run = run;
  // A reload, to speak another language say, comes back to the same run.
  if (before?.id !== run?.id) history.replaceState(null, "", run ? `#${run.id}` : location.pathname + location.search);
  $("language").disabled = run?.state === "running"; // it loads the page anew, and that takes the stop button along
  const result = Boolean(run?.summary) && ["awaiting_accept", "succeeded", "cancelled"].includes(run.state);
  $("run-card").hidden = !run || result;
  if (isNew) {
    for (const question of $$("main form.ask")) question.remove();
    keepFocus(run ? (result ? "sentence" : "run-title") : "ready-title");
  }
  if (!run) { $("result-card").hidden = true; refresh(); return; }
  $("start-card").hidden = $("ready-card").hidden = true;
  title();
  showStopped(run, state.details, again);
  const box = $("run-error");
  box.hidden = !run.error;
  fill(box, run.error ? ended(run) : []);
  $("progress").hidden = !MOVING.includes(run.state);
  $("arm").hidden = run.state !== "awaiting_arm";
  $("cancel").hidden = ENDED.includes(run.state) || run.state === "awaiting_accept";
  $("retry").hidden = !ENDED.includes(run.state);
  $("analyse").hidden = run.mode === "upload" || !run.recorded || !["failed", "stopped", "interrupted"].includes(run.state);
  emphasize();
  $("again").hidden = !ENDED.includes(run.state) && run.state !== "awaiting_accept";
  $("plan").hidden = !(run.plan && ["awaiting_arm", "running"].includes(run.state));
  // To be read before arming; while the robot moves it must not push the progress off a tablet.
  if (isNew) $("plan").open = run.state === "awaiting_arm";
  $("run-note").hidden = true;
  if (run.plan) showPlan(run, state.details);
  if (isNew || find(state.cell)?.run !== run.id) showProgress({ ...run, run: run.id });
  if (result) { showResult(run).catch(say); showDecision(run); } else $("result-card").hidden = true;
  buttons();
}

// One action of a state invites: what a stop leads to, else what makes most of what was recorded.
function emphasize() {
  const first = ["stopped-do", "analyse", "retry"].find((id) => !$(id).closest("[hidden]"));
  for (const id of ["analyse", "retry"]) $(id).classList.toggle("primary", id === first);
}

function title() {
  const { run } = state, what = `${t(`state.${run.state}`)}${run.simulated ? ` ${t("run.simulated")}` : ""}`;
  const text = blind() && !ENDED.includes(run.state) ? t("run.then", { time: clock(known.heard), what }) : what;
  if ($("run-title").textContent !== text) $("run-title").textContent = text;
}

// The button that was pressed may be gone: a keyboard goes on from the headline, not from the top of the page.
// Never from the next button: Enter pressed twice must not arm.
function keepFocus(heading) {
  setTimeout(() => { if (document.activeElement === document.body) $(heading).focus({ preventScroll: true }); }, 100);
}

const act = (type) => guarded(async () => {
  const run = state.run;
  /** @type {Api["ActionBody"]} */
  const body = { type, ...(type === "accept" || type === "reject" ? who() : {}) };
  if (type === "accept" && run.untrusted) { // for a reason or not at all
    body.override = await ask($("decide"), { title: t("override.title"), text: why(run), label: t("override.reason"), yes: t("override.yes"), least: 3 });
    if (!body.override) return;
  }
  const after = await pressing($(type), () => post(`${run.links.self}/actions`, body));
  if (state.run?.id === run.id) { state.opened = run.id; show(after); }
  look();
});
for (const type of ["arm", "cancel", "accept", "reject"]) $(type).addEventListener("click", act(type));
for (const b of $$("[data-again]")) b.addEventListener("click", () => { Object.assign(state, { dismissed: find(state.cell)?.run, opened: null }); show(null); });

// --- upload -----------------------------------------------------------------------------------------
$("upload-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const note = $("upload-note"), file = $("file").files[0];
  if (!file) { note.textContent = t("upload.choose"); return; }
  note.className = "";
  note.textContent = t("upload.going", { name: file.name, size: fmt(file.size / 1e6, 2) });
  const of = $("upload-cell").checked ? `?cell=${encodeURIComponent(state.cell)}` : "";
  try {
    const sent = call("POST", `/recordings${of}`, file, { "Content-Type": "application/x-hdf5" });
    const run = await (await sent).json();
    note.textContent = t("upload.done");
    opens(run);
  } catch (error) { note.className = "alarm"; note.textContent = sentence(error.message); }
});

// --- views ------------------------------------------------------------------------------------------
// What is done with a cell from the table of all.
const acts = {
  open: (id) => { setView("work"); enter(id); },
  begin: guarded((id, pressed) => pressing(pressed, async () => { await post(`/cells/${id}/identifications`, { mode: "full" }, unique()); look(); })),
  accept: guarded(async (run) => { await post(`${run.links.self}/actions`, { type: "accept", ...who() }); look(); }),
};
const VIEWS = {
  work: async () => {},
  upload: async () => {},
  history: () => showHistory({ id: state.cell }, guarded, (run) => { state.opened = run.id; setView("work"); fetchRun(run.id); }),
  overview: async () => showOverview(acts, true),
};
const ofAll = () => viewed() === "overview" && known.cells.length !== 1;
const viewed = () => $$("nav [aria-pressed=true]")[0].dataset.view;
function setView(name) {
  for (const b of $$("nav [data-view]")) b.setAttribute("aria-pressed", String(b.dataset.view === name));
  for (const view of Object.keys(VIEWS)) $(`view-${view}`).hidden = view !== name;
  guarded(VIEWS[name])();
  draw(false);
  redraw(); // what was drawn while its view was hidden had no width
}
for (const b of $$("nav [data-view]")) b.addEventListener("click", () => setView(b.dataset.view));
$("language").addEventListener("change", () => choose($("language").value));

// A key is asked for at the top of the page, once, and the page goes on below it.
onKeyRefused((problem) => alone("key", async () => {
  useKey(await ask($("key-place"), { title: t("key.note"), text: `${whyNot(problem)}.`, label: t("key.title"), yes: t("key.go"), least: 0, secret: true }));
  look();
}));

window.addEventListener("click", (e) => { const a = /** @type {HTMLElement} */ (/** @type {Element} */ (e.target).closest("a[data-download]")); if (a) { e.preventDefault(); guarded(download)(a.getAttribute("href"), a.dataset.download); } });

// A run in the address is what was looked at before the page was loaded anew.
if (/^#[A-Za-z0-9-]{1,40}$/.test(location.hash)) state.opened = location.hash.slice(1);
look();
