// The technician's page: one cell, one button, what will move, progress, stop, then the result.
import { call, download, follow, get, onKeyNeeded, post, Problem } from "./api.js";
import { why } from "./findings.js";
import { showHistory } from "./history.js";
import { showOverview } from "./overview.js";
import { showPlan } from "./plan.js";
import { curves, redraw } from "./plots.js";
import { showProgress } from "./progress.js";
import { showDecision, showResult } from "./result.js";
import { ended, reasonItem, refused } from "./spoken.js";
import { showStopped } from "./stopped.js";
import { $, el, fill, fmt, row, sentence, time } from "./dom.js";
import { choose, named, t } from "./texts.js";

const ENDED = ["succeeded", "failed", "cancelled", "stopped", "interrupted"];
const MOVING = ["running", "analysing", "queued", "checking"];
const state = { cells: [], cell: null, run: null, watch: 0, live: [], dismissed: null, asked: null };

// Over every view and wherever the page is scrolled to: whoever pressed a button looks at that button.
function say(error) {
  const box = $("problem");
  box.hidden = false;
  box.dataset.gone = String(!(error instanceof Problem));
  fill(box, error instanceof Problem ? refused(error) : [t("page.unreachable", { why: error.message })]);
}
const guarded = (work) => async (...given) => { $("problem").hidden = true; try { await work(...given); } catch (error) { say(error); } };

// --- stop: first of all, needs nothing but the cell's name -----------------------------------------
async function stop() {
  const note = $("stop-note");
  const cell = state.cell?.id ?? $("cell").value;
  if (!cell) return;
  note.className = "";
  note.textContent = t("stop.stopping");
  for (let attempt = 0; attempt < 5; attempt++) {
    try {
      const answer = await post(`/cells/${cell}/stop`);
      note.textContent = answer.stopping ? t("stop.sent") : t("stop.nothing");
      refresh();
      return;
    } catch (error) { note.className = "failed"; note.textContent = t("stop.failed", { why: error.message }); }
  }
}
$("stop").addEventListener("click", stop);
document.addEventListener("keydown", (e) => { if (e.key === "Escape" && !$("key-dialog").open) stop(); });

// --- cell and readiness ------------------------------------------------------------------------------
async function loadCells() {
  state.cells = (await get("/cells")).cells;
  const wanted = localStorage.getItem("invid-cell");
  fill($("cell"), state.cells.map((c) => el("option", { value: c.id, selected: c.id === wanted }, c.name)));
  await chooseCell();
}

async function chooseCell() {
  state.cell = await get(`/cells/${$("cell").value}`);
  localStorage.setItem("invid-cell", state.cell.id);
  $("simulated").hidden = !state.cell.simulated;
  // A service that knows the overview knows how to shake more gently, and whose history an upload joins.
  const able = state.cell.overview !== undefined;
  $("strength").hidden = $("upload-cell-choice").hidden = !able;
  fill($("axes"), state.cell.axes.map((a) => el("label", {}, [el("input", { type: "checkbox", name: "axis", value: a, checked: true }), el("b", {}, a)])));
  fill($("drives"), [el("table", {}, [
    row("th", ["axis", "node", "rated", "torque", "travel", "speed", "held"].map((h) => t(`drive.${h}`))),
    ...state.cell.drives.map((d, i) => {
      const l = state.cell.limits[i];
      return row("td", [d.axis, d.node_id, d.rated_torque ? `${fmt(d.rated_torque)} ${l.torque_unit}` : t("drive.from_drive"), `${fmt(l.torque)} ${l.torque_unit}`,
        `±${fmt(l.position)} ${l.position_unit}`, `${fmt(l.velocity)} ${l.position_unit}/s`, named("hold", d.hold)]);
    })])]);
  const accepted = state.cell.model;
  $("in-force").textContent = accepted ? t("ready.in_force", { time: time(accepted.accepted), by: accepted.by }) : t("ready.no_model");
  const last = state.cell.last_identification, asked = state.asked;
  state.asked = null;
  if (asked) open(asked);
  else if (last && last.id !== state.dismissed && (!ENDED.includes(last.state) || last.id === state.run?.id)) watchRun(last);
  else if (state.run && state.run.cell !== state.cell.id) show(null);
  await refresh();
}
$("cell").addEventListener("change", guarded(async () => { show(null); await chooseCell(); if (viewed() === "history") await VIEWS.history(); }));

async function refresh() {
  if (!state.cell) return;
  try {
    const ready = await get(`/cells/${state.cell.id}/readiness`);
    $("offline").hidden = true;
    if ($("problem").dataset.gone === "true") $("problem").hidden = true;
    const title = $("ready-title");
    title.textContent = ready.can_start ? t("ready.yes") : t("ready.no");
    title.className = ready.can_start ? "good" : "bad";
    fill($("reasons"), ready.reasons.map((r) => reasonItem(r)));
    fill($("ready-notes"), (ready.notes ?? []).map((r) => reasonItem(r, `note.${r.code}`)));
    const busy = state.run && !ENDED.includes(state.run.state);
    $("start-card").hidden = Boolean(state.run);
    $("ready-card").hidden = Boolean(state.run);
    $("prepare").disabled = !ready.can_start;
    if (!busy && !state.run && ready.reasons.some((r) => r.code === "run_in_progress")) {
      const last = (await get(`/cells/${state.cell.id}`)).last_identification;
      if (last && !ENDED.includes(last.state)) watchRun(last);
    }
  } catch (error) { if (!(error instanceof Problem)) $("offline").hidden = false; }
}

// --- start and follow ---------------------------------------------------------------------------------
const unique = () => ({ "Idempotency-Key": `page-${Date.now()}-${Math.random().toString(36).slice(2)}` });
async function begin(body, pressed) {
  pressed.disabled = true; // pressed twice is meant once
  try {
    watchRun(await post(`/cells/${state.cell.id}/identifications`, body, unique()));
  } finally { pressed.disabled = false; }
}
$("start-card").addEventListener("submit", guarded(async (event) => {
  event.preventDefault();
  const form = new FormData(event.target), axes = form.getAll("axis");
  if (!axes.length) { $("prepare").setCustomValidity(t("start.no_axis")); event.target.reportValidity(); $("prepare").setCustomValidity(""); return; }
  const gentler = !$("strength").hidden && form.get("amplitude") === "gentler";
  await begin({ mode: form.get("mode"), axes, ...(gentler ? { amplitude: "gentler" } : {}) }, $("prepare"));
}));
$("separate").addEventListener("click", guarded(() => begin({ mode: state.run.mode === "simulate" ? "simulate" : "full", separate: state.run.id }, $("separate"))));
const again = guarded(({ amplitude }) => begin({ mode: state.run.mode, amplitude, ...(state.run.separates ? { separate: state.run.separates } : { axes: state.run.axes }) }, $("stopped-do")));

async function watchRun(run) {
  show(run);
  const mine = ++state.watch;
  state.live = [];
  drawLive();
  await follow(run.links.events, (kind, data) => {
    if (mine !== state.watch) return;
    if (kind === "progress") showProgress({ ...state.run, ...data });
    else if (kind === "response") { state.live.push(data); drawLive(); }
    else reload();
  }, () => mine === state.watch);
  if (mine === state.watch) reload();
}

let reloading = false;
async function reload() {
  if (!state.run || reloading) { if (reloading) setTimeout(reload, 200); return; }
  reloading = true;
  try { show(await get(state.run.links.self)); } catch { /* the poll says so */ } finally { reloading = false; }
}

function show(run) {
  const before = state.run, isNew = before?.id !== run?.id || before?.state !== run?.state;
  state.run = run;
  // A reload, to speak another language say, comes back to the same run.
  history.replaceState(null, "", run ? `#${run.id}` : location.pathname + location.search);
  $("start-card").hidden = $("ready-card").hidden = Boolean(run);
  $("language").disabled = run?.state === "running"; // it loads the page anew, and that takes the stop button along
  const result = Boolean(run?.summary) && ["awaiting_accept", "succeeded", "cancelled"].includes(run.state);
  $("run-card").hidden = !run || result;
  if (isNew) keepFocus(run ? (result ? "sentence" : "run-title") : "ready-title");
  if (!run) { state.watch++; $("result-card").hidden = true; refresh(); return; }
  $("run-title").textContent = `${t(`state.${run.state}`)}${run.simulated ? ` ${t("run.simulated")}` : ""}`;
  showStopped(run, state.cell, again);
  const box = $("run-error");
  box.hidden = !run.error;
  fill(box, run.error ? ended(run) : []);
  $("progress").hidden = !MOVING.includes(run.state);
  $("arm").hidden = run.state !== "awaiting_arm";
  $("cancel").hidden = ENDED.includes(run.state) || run.state === "awaiting_accept";
  $("retry").hidden = !ENDED.includes(run.state);
  $("again").hidden = !ENDED.includes(run.state) && run.state !== "awaiting_accept";
  $("plan").hidden = !(run.plan && ["awaiting_arm", "running"].includes(run.state));
  // To be read before arming; while the robot moves it must not push the progress off a tablet.
  if (isNew) $("plan").open = run.state === "awaiting_arm";
  $("run-note").hidden = true;
  if (run.plan) showPlan(run, state.cell);
  showProgress(run);
  if (result) { showResult(run).catch(say); showDecision(run); } else $("result-card").hidden = true;
  if (before?.state !== run.state) refresh();
}

// The button that was pressed may be gone: a keyboard goes on from the headline, not from the top of the page.
// Never from the next button: Enter pressed twice must not arm.
function keepFocus(heading) {
  setTimeout(() => { if (document.activeElement === document.body) $(heading).focus({ preventScroll: true }); }, 100);
}

function drawLive() {
  const series = [], names = state.run?.axes ?? [], hues = ["--after", "--before", "--third"];
  // Beyond three axes the last experiment alone; more curves than that nobody tells apart.
  const many = (state.cell?.axes.length ?? 0) > hues.length;
  for (const response of state.live.slice(many ? -1 : -3)) {
    response.db.forEach((db, i) => db && series.push({
      label: t("run.live.series", { axis: state.cell?.axes[i] ?? names[i] ?? i, n: Number(response.experiment) + 1 }), x: response.frequency_hz, y: db, colour: hues[i % 3], dash: many ? Math.floor(i / hues.length) % 3 : Number(response.experiment) % 3,
    }));
  }
  $("live").hidden = !series.length;
  const alt = t("run.live.alt", { n: series.length, what: series.map((s) => s.label).join(", ") });
  if (series.length) curves($("live-plot"), { x: t("chart.frequency"), y: t("run.live.y"), series, logY: false, alt });
}

// A result that is not to be trusted is accepted for a reason or not at all.
function reason(run) {
  const dialog = $("override-dialog");
  $("override-why").textContent = why(run);
  $("override").value = "";
  dialog.returnValue = "no"; // Escape is no yes
  dialog.showModal();
  return new Promise((resolve) => dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes" ? $("override").value.trim() : null), { once: true }));
}

const act = (type) => guarded(async () => {
  const body = { type };
  if (type === "accept" && state.run.untrusted) { body.override = await reason(state.run); if (!body.override) return; }
  const run = await post(`${state.run.links.self}/actions`, body);
  show(run);
  if (type === "accept") { state.cell = await get(`/cells/${state.cell.id}`); $("in-force").textContent = t("ready.in_force_now"); }
});
for (const type of ["arm", "cancel", "accept", "reject"]) $(type).addEventListener("click", act(type));
for (const b of document.querySelectorAll("[data-again]")) b.addEventListener("click", () => { state.dismissed = state.run?.id; show(null); });

// --- upload -----------------------------------------------------------------------------------------
$("upload-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const note = $("upload-note"), file = $("file").files[0];
  if (!file) return;
  note.className = "";
  note.textContent = t("upload.going", { name: file.name, size: fmt(file.size / 1e6, 2) });
  const of = !$("upload-cell-choice").hidden && $("upload-cell").checked ? `?cell=${encodeURIComponent(state.cell.id)}` : "";
  try {
    const run = await (await call("POST", `/recordings${of}`, file, { "Content-Type": "application/x-hdf5" })).json();
    note.textContent = t("upload.done");
    setView("work");
    watchRun(run);
  } catch (error) { note.className = "alarm"; note.textContent = sentence(error.message); }
});

// --- views ------------------------------------------------------------------------------------------
const open = (run) => { setView("work"); state.dismissed = null; watchRun(run); };
const VIEWS = {
  work: async () => {},
  upload: async () => {},
  history: () => showHistory(state.cell, guarded, open),
  overview: () => showOverview(guarded(async (id) => { $("cell").value = id; setView("work"); if (state.run && state.run.cell !== id) show(null); await chooseCell(); })),
};
const viewed = () => document.querySelector("nav [aria-pressed=true]").dataset.view;
function setView(name) {
  for (const b of document.querySelectorAll("nav [data-view]")) b.setAttribute("aria-pressed", String(b.dataset.view === name));
  for (const view of Object.keys(VIEWS)) $(`view-${view}`).hidden = view !== name;
  guarded(VIEWS[name])();
  redraw(); // what was drawn while its view was hidden had no width
}
for (const b of document.querySelectorAll("nav [data-view]")) b.addEventListener("click", () => setView(b.dataset.view));
$("language").addEventListener("change", () => choose($("language").value));

onKeyNeeded(() => new Promise((resolve) => {
  const dialog = $("key-dialog");
  $("key").value = "";
  dialog.addEventListener("close", () => resolve($("key").value.trim() || null), { once: true });
  if (!dialog.open) dialog.showModal();
}));

window.addEventListener("click", (e) => { const a = e.target.closest("a[data-download]"); if (a) { e.preventDefault(); guarded(download)(a.getAttribute("href"), a.dataset.download); } });

async function start() {
  // A run in the address is what was looked at before the page was loaded anew.
  const asked = location.hash.slice(1);
  if (/^[A-Za-z0-9-]{1,40}$/.test(asked)) state.asked = await get(`/identifications/${asked}`).catch(() => null);
  if (state.asked?.cell) localStorage.setItem("invid-cell", state.asked.cell);
  await loadCells();
}
guarded(start)();
setInterval(refresh, 3000);
