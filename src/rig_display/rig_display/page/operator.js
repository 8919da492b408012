// The operator's page: trials, the filter, how everything is.

import { Surface } from "./canvas.js";
import { Choosing } from "./choose.js";
import { Link } from "./link.js";
import { Playback } from "./playback.js";
import { Plot } from "./plot.js";
import { Scene } from "./scene.js";
import { VERDICTS, onStopKey, outcome, where } from "./words.js";

const $ = (id) => document.getElementById(id);
const MODES = ["off", "training", "assistance"];
const link = new Link("operator");
const choosing = new Choosing(link);
const view = new Surface($("view"));
const plots = {
  force: new Plot($("force"), [{ dots: VERDICTS }], 20),
  state: new Plot($("state"), [{ line: "bob" }], 0.5, { zero: false }),
  criterion: new Plot($("criterion"), [{ line: "quiet", dash: [6, 5] }, { dots: VERDICTS }], 1),
  latency: new Plot($("latency"), [{ dots: ["rejected"] }, { line: "replaced" }], 5),
};
let task = null;
let scene = null;
let playback = null;
let status = null;
let axis = 0;
const forces = new Map(); // of ticks whose decision has not come
let lastTime = -1;

link.addEventListener("task", ({ detail }) => {
  task = detail;
  scene = new Scene(task);
  playback = new Playback(task);
  axis = task.limits.indexOf(Math.max(...task.limits));
  const [name, unit] = task.states[task.scene.plot];
  $("stateName").textContent = `State ${name} [${unit}]`;
});
link.addEventListener("ticks", ({ detail }) => {
  playback.add(detail.s, performance.now());
  for (const [tick, time, , , , , state, force, latency] of detail.s) {
    if (time < lastTime) {
      forces.clear();
      for (const plot of Object.values(plots)) plot.clear();
    }
    lastTime = time;
    forces.set(tick, force[axis]);
    plots.state.add(0, time, state[task.scene.plot]);
    plots.latency.add(0, time, latency);
  }
  for (const [tick, verdict, , criterion, threshold, , compute] of detail.d) {
    const time = tick * task.sample;
    if (forces.has(tick)) plots.force.add(0, time, forces.get(tick), verdict);
    for (const old of forces.keys()) if (old <= tick) forces.delete(old);
    plots.criterion.add(0, time, threshold);
    plots.criterion.add(1, time, criterion, verdict);
    plots.latency.add(1, time, compute);
  }
});
link.addEventListener("status", ({ detail }) => {
  // What was answered is of a moment that has passed.
  if (status !== null && status.trial.phase !== detail.trial.phase) $("note").textContent = "";
  status = detail;
  show();
});
link.addEventListener("choices", ({ detail }) => {
  choosing.offer(detail);
  show();
});
link.addEventListener("open", () => ($("note").textContent = ""));
link.addEventListener("note", ({ detail }) => {
  $("note").textContent = detail.text;
  $("note").className = `note ${detail.good ? "quiet" : "warn"}`;
});
link.addEventListener("closed", () => {
  status = null;
  show();
});
link.addEventListener("stopping", () => show());

// No session is led yet, and somebody may choose one.
const waiting = () => status.choosing && status.session === null;

function phase() {
  const silent = "the rig does not answer";
  if (link.stopping && !link.open) return [`stop NOT delivered: ${silent}; it is sent as soon as the link is back`, true];
  if (status === null) return choosing.beginning ? [choosing.beginning, false] : [silent, true];
  const { trial, countdown, hand, faults, loss, troubles } = status;
  if (hand.stopped) return [`stopped by ${hand.stopped}`, true];
  if (faults.length) return [`${loss || "no force"}; until Release: ${faults.join("; ")}`, true];
  if (loss) return [loss, true];
  if (troubles.length) return [troubles.join("; "), true];
  if (waiting()) return ["waiting for a choice", false];
  if (countdown !== null) return [`starts in ${Math.ceil(countdown)} s`, false];
  if (trial.phase === "arming") return [trial.message || "getting ready", false];
  if (trial.phase === "aborted") return [`aborted: ${trial.message}`, true];
  if (trial.phase === "finished") return [`finished ${outcome(trial.outcome).toLowerCase()}`, false];
  return [trial.phase, false];
}

const halted = () => Boolean(status?.hand.stopped || status?.faults.length);

const ms = (values) => (values?.[0] == null ? "–" : `${values[0].toFixed(1)}, ${values[1].toFixed(1)} ms`);

function show() {
  const [text, bad] = phase();
  $("how").textContent = text;
  $("how").className = bad ? "warn" : "quiet";
  // What is not known any more is not shown, and what would not arrive cannot be pressed; a stop can.
  for (const each of document.querySelectorAll("aside button, aside input")) each.disabled = status === null;
  choosing.show(status);
  if (status === null) {
    $("stop").firstChild.textContent = "Stop ";
    $("decision").textContent = "";
    table($("link"), [["rig", "does not answer", true]]);
    return;
  }
  const { trial, hand, latency, recorder, driver } = status;
  $("where").textContent = where(trial);
  $("of").textContent = trial.duration ? `of ${trial.duration.toFixed(0)} s` : "s";
  $("stop").firstChild.textContent = halted() ? "Release " : "Stop ";
  const going = ["arming", "running"].includes(trial.phase) || status.countdown !== null;
  const { session } = status;
  const led = session !== null && !session.over;
  $("start").disabled = going || driver === null || Boolean(hand.stopped);
  $("abort").disabled = !going;
  $("session").hidden = session === null;
  $("trial").hidden = waiting();
  // Its conductor names, starts and sets everything.
  const conducted = led || status.choosing;
  $("byHand").hidden = $("start").hidden = conducted;
  for (const mode of MODES) $(mode).disabled = conducted;
  if (session !== null) {
    const minutes = (session.remaining / 60).toFixed(1);
    $("progress").textContent =
      `${session.subject}: ${session.done} of ${session.planned} trials, ${minutes} min left. ${session.set} ${session.trial}: ${session.doing}`;
    $("resume").disabled = !session.waiting || driver === null;
    $("pause").disabled = session.waiting || session.over;
    $("repeat").disabled = !session.waiting || session.done === 0;
  }
  for (const mode of MODES) $(mode).setAttribute("aria-pressed", String(status.mode === mode));
  $("decision").textContent = status.decision ?? "no decision";
  $("feedback").setAttribute("aria-pressed", String(status.feedback));
  const missed = Math.max(trial.missed ?? 0, trial.phase === "running" ? (playback?.newest?.missed ?? 0) : 0);
  table($("link"), [
    ["driver", driver ?? "nobody", driver === null],
    ["hand", hand.reason || `${hand.rate.toFixed(0)} messages/s`, Boolean(hand.reason)],
    ["pointer to wrench", ms(latency.hand)],
    ["state to drawn", ms(latency.drawn)],
    ["round trip", latency.round_trip == null ? "–" : `${latency.round_trip.toFixed(1)} ms`],
    ["frames", latency.frames == null ? "–" : `${latency.frames.toFixed(0)} /s`],
    ["watching", String(status.watchers)],
    ["missed deadlines", String(missed), missed > 0],
    ["recorder", recording(recorder), recorder === null ? !waiting() : recorder.lost > 0],
    ["refused", status.refused ? `${status.refused}, last: ${status.refusal}` : "0", status.refused > 0],
  ]);
}

function recording(recorder) {
  if (recorder === null) return "none";
  const lost = recorder.lost ? `, ${recorder.lost} lost` : "";
  const size = `${(recorder.bytes / 1e6).toFixed(1)} MB`;
  return recorder.recording ? `recording, ${size}${lost}` : `closed, ${size}${lost}`;
}

// Rows of name, value and whether it is amiss.
function table(list, rows) {
  if (list.children.length !== 2 * rows.length) {
    const cells = rows.flatMap(([name]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      document.createElement("dd"),
    ]);
    list.replaceChildren(...cells);
  }
  rows.forEach(([, value, amiss], i) => {
    const cell = list.children[2 * i + 1];
    cell.textContent = amiss ? `⚠ ${value}` : value;
    cell.className = amiss ? "warn" : "";
  });
}

$("start").onclick = () =>
  link.say("start", {
    subject: $("subject").value,
    group: $("group").value,
    set: $("set").value,
    trial: Math.max(0, Math.round(Number($("number").value)) || 0),
    duration: Math.max(0, Number($("duration").value) || 0),
  });
for (const what of ["pause", "resume", "repeat"]) $(what).onclick = () => link.say("session", { do: what });
$("abort").onclick = () => link.say("abort", { reason: "aborted by the operator" });
for (const mode of MODES) $(mode).onclick = () => link.say("mode", { mode });
$("feedback").onclick = () => link.say("feedback", { on: !status?.feedback });
$("stop").onclick = () => (halted() ? link.say("release") : link.stop());
onStopKey(() => link.stop());

let count = 0;
function frame(now) {
  requestAnimationFrame(frame);
  if (!task) return;
  const row = playback.at(now) ?? { state: task.initial, time: 0, inside: false, passed: [] };
  if (view.begin()) scene.draw(view, row);
  $("clock").textContent = row.time.toFixed(1);
  // The strips need not be as smooth as the task.
  if (count++ % 4 === 0) for (const plot of Object.values(plots)) plot.draw();
}
requestAnimationFrame(frame);
