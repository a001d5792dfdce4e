// The technician's page: one cell, one button, what will move, progress, stop, then the result.
import { call, download, follow, get, onKeyNeeded, post, Problem } from "./api.js";
import { showResult } from "./result.js";
import { curves, redraw } from "./plots.js";
import { clear, el, fill, fmt, row, table, time } from "./dom.js";

const $ = (id) => document.getElementById(id);
const ENDED = ["succeeded", "failed", "cancelled", "stopped", "interrupted"];
const WORDS = {
  queued: "Waiting to start", checking: "Checking the plan", awaiting_arm: "Ready to move: this will happen",
  running: "Measuring: the robot moves", analysing: "Analysing: nothing moves", awaiting_accept: "Result: accept or reject it",
  succeeded: "Done", failed: "Failed", cancelled: "Cancelled", stopped: "Stopped", interrupted: "Interrupted by a restart of the service",
};
const state = { cells: [], cell: null, run: null, watch: 0, live: [], dismissed: null };

// Over every view and wherever the page is scrolled to: whoever pressed a button looks at that button.
function say(error) {
  const box = $("problem");
  box.hidden = false;
  box.dataset.gone = String(!(error instanceof Problem));
  box.textContent = error instanceof Problem ? error.message : `The service cannot be reached: ${error.message}`;
}
const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);
const guarded = (work) => async (...given) => { $("problem").hidden = true; try { await work(...given); } catch (error) { say(error); } };

// --- stop: first of all, needs nothing but the cell's name -----------------------------------------
async function stop() {
  const note = $("stop-note");
  const cell = state.cell?.id ?? $("cell").value;
  if (!cell) return;
  note.className = "";
  note.textContent = "Stopping…";
  for (let attempt = 0; attempt < 5; attempt++) {
    try {
      const answer = await post(`/cells/${cell}/stop`);
      note.textContent = answer.stopping ? "STOP sent." : "STOP sent. Nothing was moving.";
      refresh();
      return;
    } catch (error) { note.className = "failed"; note.textContent = `STOP NOT SENT. USE THE EMERGENCY STOP. (${error.message})`; }
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
  fill($("axes"), state.cell.axes.map((a) => el("label", {}, [el("input", { type: "checkbox", name: "axis", value: a, checked: true }), el("b", {}, a)])));
  const table = el("table", {}, [
    row("th", ["Axis", "Node", "Rated", "Torque limit", "Travel limit", "Speed limit", "Held by"]),
    ...state.cell.drives.map((d, i) => {
      const l = state.cell.limits[i];
      return row("td", [d.axis, d.node_id, d.rated_torque ? `${d.rated_torque} ${l.torque_unit}` : "from drive", `${l.torque} ${l.torque_unit}`,
        `±${l.position} ${l.position_unit}`, `${l.velocity} ${l.position_unit}/s`, { drive: "drive", master_pd: "master (PD)", master_p: "master (P)" }[d.hold] ?? d.hold]);
    })]);
  fill($("drives"), [table]);
  const accepted = state.cell.model;
  $("in-force").textContent = accepted ? `Model in force: ${accepted.id}, accepted ${time(accepted.accepted)} by ${accepted.by}.` : "No accepted model yet.";
  const last = state.cell.last_identification;
  if (last && last.id !== state.dismissed && (!ENDED.includes(last.state) || last.id === state.run?.id)) watchRun(last);
  else if (state.run && state.run.cell !== state.cell.id) show(null);
  await refresh();
}
$("cell").addEventListener("change", guarded(async () => { show(null); await chooseCell(); }));

async function refresh() {
  if (!state.cell) return;
  try {
    const ready = await get(`/cells/${state.cell.id}/readiness`);
    $("offline").hidden = true;
    if ($("problem").dataset.gone === "true") $("problem").hidden = true;
    const title = $("ready-title");
    title.textContent = ready.can_start ? "✓ Ready to measure" : "✗ Cannot start now";
    title.className = ready.can_start ? "good" : "bad";
    fill($("reasons"), ready.reasons.map((r) => el("li", {}, [el("b", {}, sentence(r.text)), `What to do: ${r.fix}.`])));
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
$("start-card").addEventListener("submit", guarded(async (event) => {
  event.preventDefault();
  const form = new FormData(event.target), axes = form.getAll("axis");
  if (!axes.length) { $("prepare").setCustomValidity("Choose at least one axis."); event.target.reportValidity(); $("prepare").setCustomValidity(""); return; }
  const key = `page-${Date.now()}-${Math.random().toString(36).slice(2)}`;
  $("prepare").disabled = true; // pressed twice is meant once
  try {
    watchRun(await post(`/cells/${state.cell.id}/identifications`, { mode: form.get("mode"), axes }, { "Idempotency-Key": key }));
  } finally { $("prepare").disabled = false; }
}));

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
  const before = state.run;
  state.run = run;
  $("run-card").hidden = !run;
  $("start-card").hidden = Boolean(run);
  $("ready-card").hidden = Boolean(run);
  if (before?.state !== run?.state) keepFocus(run ? "run-title" : "ready-title");
  if (!run) { state.watch++; $("result-card").hidden = true; refresh(); return; }
  $("run-title").textContent = WORDS[run.state] + (run.simulated ? " (simulated)" : "");
  const box = $("run-error");
  box.hidden = !run.error;
  box.textContent = run.error ? `${sentence(run.error.text)}. What to do: ${run.error.fix}.` : "";
  const moving = ["running", "analysing", "queued", "checking"].includes(run.state);
  $("progress").hidden = !moving;
  $("arm").hidden = run.state !== "awaiting_arm";
  $("cancel").hidden = ENDED.includes(run.state) || run.state === "awaiting_accept";
  $("again").hidden = !ENDED.includes(run.state) && run.state !== "awaiting_accept";
  $("plan").hidden = !(run.plan && ["awaiting_arm", "running"].includes(run.state));
  // To be read before arming; while the robot moves it must not push the progress off a tablet.
  if (before?.id !== run.id || before.state !== run.state) $("plan").open = run.state === "awaiting_arm";
  if (run.plan && before?.plan !== run.plan) showPlan(run);
  showProgress(run);
  if (["awaiting_accept", "succeeded", "cancelled"].includes(run.state) && run.summary) showResult(run, state.cell);
  else $("result-card").hidden = true;
  // A result that is not to be trusted does not invite.
  $("accept").classList.toggle("primary", !run.untrusted);
  $("accept").textContent = run.untrusted ? "Accept all the same…" : "✓ Accept this model";
  if (before?.state !== run.state) refresh();
}

// The button that was pressed may be gone: a keyboard goes on from the headline, not from the top of the page.
// Never from the next button: Enter pressed twice must not arm.
function keepFocus(heading) {
  setTimeout(() => { if (document.activeElement === document.body) $(heading).focus({ preventScroll: true }); }, 100);
}

function showPlan(run) {
  const plan = run.plan;
  const rotary = (f) => (f.unit === "N" ? ["mm", 1000] : ["°", 180 / Math.PI]);
  // What cannot be foretold is bounded all the same: the sweep stops every axis at its limits.
  const limits = new Map((state.cell?.limits ?? []).map((l) => [l.axis, l]));
  table($("plan-table"), ["Axis", "Torque up to", "Moves up to", "Speed up to"], (plan.forecast ?? []).map((f) => {
    const [unit, factor] = rotary(f), l = limits.get(f.axis), shown = (v) => `${fmt(v * factor, 2)}${unit === "°" ? "" : " "}${unit}`;
    const most = (v, limit, sign, per) => (v != null && !(v > limit) ? `${sign}${shown(v)}${per}`
      : limit == null ? "not foreseen" : `${v == null ? "not foreseen; " : ""}stopped at ${sign}${shown(limit)}${per}`);
    const travel = most(f.travel, l?.position, "±", ""), speed = most(f.velocity, l?.velocity, "", "/s");
    return { cells: [el("b", {}, f.axis), `±${fmt(f.peak_torque, 3)} ${f.unit}`, travel, speed] };
  }));
  $("plan-facts").textContent = `Takes about ${fmt(plan.duration_s, 3)} s of robot time in ${plan.experiments?.length ?? "?"} experiments. Motion stops by itself at the limits.${run.simulated ? "" : " Arm only where the emergency stop is within reach and nobody is within reach of the axes."}`;
  fill($("plan-warnings"), (plan.warnings ?? []).map((w) => el("li", {}, w)));
}

function showProgress(run) {
  $("bar").value = run.progress;
  const parts = [run.phase, run.axis && `axis ${run.axis}`, run.frequency && `${fmt(run.frequency, 3)} Hz`, run.eta_s != null && `about ${Math.ceil(run.eta_s)} s of robot time left`];
  $("phase").textContent = `${Math.round(run.progress * 100)} %: ${parts.filter(Boolean).join(", ")}`;
}

function drawLive() {
  const series = [], names = state.run?.axes ?? [], hues = ["--after", "--before", "--third"];
  for (const response of state.live.slice(-3)) {
    response.db.forEach((db, i) => db && series.push({
      label: `${state.cell?.axes[i] ?? names[i] ?? i} (experiment ${Number(response.experiment) + 1})`, x: response.frequency_hz, y: db, colour: hues[i % 3], dash: Number(response.experiment) % 3,
    }));
  }
  $("live").hidden = !series.length;
  if (series.length) curves($("live-plot"), { x: "frequency [Hz]", y: "position per torque [dB]", series, logY: false });
}

// A result that is not to be trusted is accepted for a reason or not at all.
function reason(why) {
  const dialog = $("override-dialog");
  $("override-why").textContent = `${sentence(why)}.`;
  $("override").value = "";
  dialog.returnValue = "no"; // Escape is no yes
  dialog.showModal();
  return new Promise((resolve) => dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes" ? $("override").value.trim() : null), { once: true }));
}

const act = (type) => guarded(async () => {
  const body = { type };
  if (type === "accept" && state.run.untrusted) { body.override = await reason(state.run.untrusted); if (!body.override) return; }
  const run = await post(`${state.run.links.self}/actions`, body);
  show(run);
  if (type === "accept") { state.cell = await get(`/cells/${state.cell.id}`); $("in-force").textContent = `Model in force: ${state.cell.model?.id}, accepted just now.`; }
});
for (const type of ["arm", "cancel", "accept", "reject"]) $(type).addEventListener("click", act(type));
$("again").addEventListener("click", () => { state.dismissed = state.run?.id; show(null); });

// --- history -----------------------------------------------------------------------------------------
// The month in letters: 11/12/26 is two days, depending on who reads it.
const LISTED = new Intl.DateTimeFormat([], { dateStyle: "medium", timeStyle: "short" });
const when = (text) => LISTED.format(new Date(text));
const loadHistory = guarded(async () => {
  const { history } = await get(`/cells/${state.cell.id}/models`);
  const changes = $("history-changes");
  const restore = (m) => guarded(async () => { await post(`/cells/${state.cell.id}/models/${m.id}/restore`); loadHistory(); });
  const compare = (m) => guarded(async () => {
    // As the result does: either side is the mean of the accepted runs that agree with it.
    const answer = await get(`/cells/${state.cell.id}/changes?from=${m.id}&to=${history[0].id}&averaged=true`);
    changes.textContent = `Since ${time(m.accepted)}: ${answer.sentence}`;
  });
  const button = (text, work) => { const b = el("button", { type: "button" }, text); b.addEventListener("click", work); return b; };
  clear(changes);
  table($("accepted"), ["Accepted", "Model", "By", ""], history.map((m, i) => ({ cells: [when(m.accepted), `…${m.id.slice(-8)}`, `${m.by} (${m.how})`,
    i ? el("span", { class: "actions" }, [button("Compare with now", compare(m)), button("Restore", restore(m))]) : el("b", {}, "in force")] })));
  const { identifications } = await get(`/identifications?cell=${state.cell.id}`);
  const open = (r) => () => { setView("work"); state.dismissed = null; watchRun(r); };
  table($("runs"), ["Started", "Mode", "State", "Result", ""], identifications.map((r) => ({ cells: [when(r.created), r.mode, WORDS[r.state].split(":")[0],
    r.summary?.sentences?.[0] ?? r.error?.text ?? "", button("Show", open(r))] })));
});

// --- upload -----------------------------------------------------------------------------------------
$("upload-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const note = $("upload-note"), file = $("file").files[0];
  if (!file) return;
  note.className = "";
  note.textContent = `Uploading ${file.name} (${fmt(file.size / 1e6, 2)} MB)…`;
  try {
    const run = await (await call("POST", "/recordings", file, { "Content-Type": "application/x-hdf5" })).json();
    note.textContent = "Uploaded.";
    setView("work");
    watchRun(run);
  } catch (error) { note.className = "alarm"; note.textContent = sentence(error.message); }
});

function setView(name) {
  for (const button of document.querySelectorAll("nav button")) button.setAttribute("aria-pressed", String(button.dataset.view === name));
  for (const view of ["work", "history", "upload"]) $(`view-${view}`).hidden = view !== name;
  if (name === "history") loadHistory();
  redraw(); // what was drawn while its view was hidden had no width
}
for (const button of document.querySelectorAll("nav button")) button.addEventListener("click", () => setView(button.dataset.view));

onKeyNeeded(() => new Promise((resolve) => {
  const dialog = $("key-dialog");
  $("key").value = "";
  dialog.addEventListener("close", () => resolve($("key").value.trim() || null), { once: true });
  if (!dialog.open) dialog.showModal();
}));

window.addEventListener("click", (e) => { const a = e.target.closest("a[data-download]"); if (a) { e.preventDefault(); guarded(download)(a.getAttribute("href"), a.dataset.download); } });
guarded(loadCells)();
setInterval(refresh, 3000);
