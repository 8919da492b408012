// The driver's page: the task, the hand, the stop.

import { Surface, colour } from "./canvas.js";
import { Hand } from "./hand.js";
import { Link } from "./link.js";
import { Playback } from "./playback.js";
import { Scene } from "./scene.js";
import { SIGNS, VERDICTS, onStopKey, outcome, where } from "./words.js";

const $ = (id) => document.getElementById(id);
const link = new Link("driver");
const view = new Surface($("view"));
const gauge = new Surface($("gauge"));
let task = null;
let scene = null;
let playback = null;
let status = null;
let wasDriving = false;
let verdict = null; // of the newest decision
let held = { since: null, time: 0 };

const hand = new Hand(link, $("view"), (x, y) => scene.toWorld(view, x, y), () => playback.newest);

link.addEventListener("task", ({ detail }) => {
  const first = task === null;
  task = hand.task = detail;
  scene = new Scene(task);
  playback = new Playback(task);
  if (first) hand.kind = task.hand;
  show();
});
link.addEventListener("ticks", ({ detail }) => {
  playback.add(detail.s, performance.now());
  for (const row of detail.s) keepTime(row);
  const decision = detail.d.at(-1);
  if (!decision) return;
  const was = verdict;
  verdict = decision[1];
  if (status?.feedback && verdict > 0 && was === 0) hand.pulse();
});
link.addEventListener("status", ({ detail }) => {
  status = detail;
  hand.driving = wasDriving = detail.driving;
  show();
});
link.addEventListener("note", ({ detail }) => ($("text").textContent = detail.text));
link.addEventListener("open", () => wasDriving && link.say("drive"));
link.addEventListener("closed", ({ detail }) => {
  status = null;
  hand.driving = false;
  show(detail);
});
link.addEventListener("stopping", () => show());

// Whatever the hand does, nothing is pushed until it is released.
const halted = () => link.stopping || Boolean(status?.hand.stopped || status?.faults.length);

function keepTime(row) {
  const inside = row[3] & 1;
  if (!inside) held = { since: null, time: 0 };
  else if (held.since === null) held = { since: row[1], time: 0 };
  else held.time = row[1] - held.since;
}

// What stands over the picture while an emergency stop is on its way.
function onItsWay() {
  const lost = "Not delivered: the link to the rig is lost, and without it the hand pushes nothing. "
    + "The stop is sent as soon as the link is back.";
  return { title: "Emergency stop", text: link.open ? "Sent; the rig has not confirmed it yet." : lost };
}

// What stands over the picture: what to do next.
function next() {
  const { trial, hand: state, driver, driving, countdown } = status;
  if (state.stopped) {
    const mine = driving && task.driver_starts;
    const text = `Emergency stop, pressed by ${state.stopped}. The hand pushes nothing.`;
    return { title: "Stopped", text, act: mine && ["Release", () => link.say("release")] };
  }
  if (status.faults.length) {
    const text = `${status.faults.join("; ")}, until it is released.`;
    return { title: "No force", text, act: driving && task.driver_starts && ["Release", () => link.say("release")] };
  }
  if (!driving && driver === null) {
    const act = ["Take control", () => link.say("drive")];
    return { title: "Nobody drives", text: "Take control to push with your hand.", act };
  }
  if (!driving) return { title: "", text: trial.phase === "running" ? "" : "Somebody else drives; you watch." };
  if (countdown !== null) return { title: "", text: "", count: Math.ceil(countdown) };
  if (trial.phase === "arming") return { title: "Getting ready", text: trial.message };
  if (trial.phase === "running") return { title: "", text: "" };
  if (status.choosing && status.session === null) return { title: "Welcome", text: "Your session begins soon." };
  if (status.session?.over) return { title: "Done", text: "That was the last trial. Thank you." };
  if (status.session?.instructions) return { title: "Next", text: status.session.instructions };
  const [title, text] = {
    idle: ["Ready", "Press and drag to push; the arrow keys and a gamepad work too. Esc stops."],
    finished: [outcome(trial.outcome) || "Done", status.session ? status.session.doing : "The trial has ended."],
    aborted: ["Ended early", trial.message],
  }[trial.phase];
  return { title, text, act: task.driver_starts && [trial.phase === "idle" ? "Start" : "Again", start] };
}

function start() {
  const { subject = "", group = "", set = "", trial: number = 0, phase } = status.trial;
  link.say("start", { subject, group, set, trial: phase === "idle" ? number : number + 1, duration: 0 });
}

let act = () => {};
$("act").onclick = () => act();

function show(closed = "") {
  const ready = status !== null && task !== null;
  const connecting = { title: "Connecting", text: closed || "The rig does not answer yet." };
  const now = link.stopping ? onItsWay() : ready ? next() : connecting;
  $("title").textContent = now.title;
  if (now.text !== $("text").dataset.from) {
    $("text").dataset.from = $("text").textContent = now.text;
  }
  $("count").hidden = !now.count;
  $("count").textContent = now.count ?? "";
  $("act").hidden = !now.act;
  if (now.act) [$("act").textContent, act] = now.act;
  $("veil").classList.toggle("stopped", halted());
  $("leave").hidden = !hand.driving;
  if (!ready) return;
  $("where").textContent = where(status.trial);
  $("of").textContent = status.trial.duration ? `of ${status.trial.duration.toFixed(0)} s` : "s";
  for (const kind of ["direct", "spring"]) $(kind).setAttribute("aria-pressed", String(hand.kind === kind));
  $("spring").disabled = !task.scene.hand?.spring;
  $("feedback").setAttribute("aria-pressed", String(status.feedback));
  $("feedback").hidden = !task.driver_starts;
}

for (const kind of ["direct", "spring"]) $(kind).onclick = () => ((hand.kind = kind), show());
$("feedback").onclick = () => link.say("feedback", { on: !status?.feedback });
$("leave").onclick = () => link.say("leave");
$("stop").onclick = () => link.stop();
onStopKey(() => link.stop());

function frame(now) {
  requestAnimationFrame(frame);
  if (!task || !view.begin()) return;
  const row = playback.at(now) ?? { state: task.initial, time: 0, inside: false, force: [0, 0, 0], passed: [] };
  const grip = scene.draw(view, row);
  if (hand.driving && !halted()) drawHand(grip);
  drawGauge();
  $("clock").textContent = row.time.toFixed(1);
  say(row);
  const end = performance.now();
  link.frames += 1;
  for (const { received } of row.passed) link.drawn.push(end - link.toPage(received));
}

function say(row) {
  const running = status?.trial.phase === "running";
  const idle = running && hand.driving && status.hand.reason;
  const why = idle ? `no force: ${idle}` : running ? status.loss : "";
  const show = Boolean(running && status.feedback && verdict !== null);
  const name = show ? VERDICTS[verdict] : "";
  let text = "";
  if (why) text = why;
  else if (show) text = `${SIGNS[verdict]} ${name}`;
  else if (row.inside) text = held.time >= task.dwell ? "✓ held" : `✓ in the region ${held.time.toFixed(1)} s`;
  $("how").textContent = text;
  $("how").className = `how ${why ? "warn" : name}`;
}

// The force as an arrow at what it pushes; under a press, the scale of the drag or the spring.
function drawHand(grip) {
  const pen = view.pen;
  const [fx, fy] = [hand.force[0], hand.force[hand.upright]];
  const [lx, ly] = [task.limits[0] || 1, task.limits[hand.upright] || 1];
  const size = Math.max(18, 0.04 * view.height);
  pen.save();
  pen.lineCap = "round";
  const tint = status?.feedback && verdict !== null ? colour(VERDICTS[verdict]) : colour("hand");
  pen.strokeStyle = pen.fillStyle = tint;
  if (hand.pressed) {
    const [from, to] = [hand.pressed.from, hand.pressed.to];
    pen.lineWidth = 2;
    if (hand.kind === "spring" && task.scene.hand?.spring) {
      pen.setLineDash([6, 6]);
      line(pen, grip, [to[0], grip[1]]);
    } else {
      pen.setLineDash([4, 6]);
      pen.beginPath();
      if (task.limits[hand.upright]) pen.ellipse(...from, hand.reach, hand.reach, 0, 0, 2 * Math.PI);
      else for (const side of [-1, 1]) {
        pen.moveTo(from[0] + side * hand.reach, from[1] - size);
        pen.lineTo(from[0] + side * hand.reach, from[1] + size);
      }
      pen.stroke();
      pen.setLineDash([]);
      line(pen, from, [to[0], task.limits[hand.upright] ? to[1] : from[1]]);
      view.font(0.7 * size);
      pen.textAlign = "center";
      pen.fillText(`${lx} N`, from[0] + hand.reach, from[1] + 1.8 * size);
    }
    pen.setLineDash([]);
    pen.beginPath();
    pen.arc(...to, 9, 0, 2 * Math.PI);
    pen.fill();
  }
  const long = 0.2 * Math.min(view.width, view.height);
  const [dx, dy] = [(fx / lx) * long, (-fy / ly) * long];
  if (Math.hypot(dx, dy) > 2) {
    const tip = [grip[0] + dx, grip[1] + dy];
    const angle = Math.atan2(dy, dx);
    pen.lineWidth = Math.max(5, 0.012 * view.height);
    line(pen, grip, tip);
    pen.beginPath();
    for (const turn of [angle, angle + 2.5, angle - 2.5]) {
      pen.lineTo(tip[0] + Math.cos(turn) * 0.7 * size, tip[1] + Math.sin(turn) * 0.7 * size);
    }
    pen.fill();
    view.font(size, 600);
    pen.textAlign = dx >= 0 ? "left" : "right";
    pen.textBaseline = "middle";
    const above = Math.abs(dy) > Math.abs(dx) ? 0 : 0.8 * size;
    pen.fillText(`${Math.hypot(fx, fy).toFixed(0)} N`, tip[0] + Math.sign(dx || 1) * size, tip[1] - above);
  }
  pen.restore();
}

function line(pen, from, to) {
  pen.beginPath();
  pen.moveTo(...from);
  pen.lineTo(...to);
  pen.stroke();
}

// Newtons along the page, from limit to limit.
function drawGauge() {
  if (!gauge.begin()) return;
  const { pen, width, height } = gauge;
  const limit = task.limits[0] || task.limits[hand.upright];
  const force = halted() ? [0, 0, 0] : hand.force;
  const value = task.limits[0] ? force[0] : force[hand.upright];
  const [left, right, y] = [34, width - 34, 0.3 * height];
  const to = (newtons) => 0.5 * (left + right) + (0.5 * (right - left) * newtons) / limit;
  pen.fillStyle = colour("line");
  pen.fillRect(left, y - 5, right - left, 10);
  pen.fillStyle = colour("hand");
  pen.fillRect(Math.min(to(0), to(value)), y - 7, Math.abs(to(value) - to(0)), 14);
  pen.fillStyle = colour("ink");
  pen.fillRect(to(0) - 1, y - 9, 2, 18);
  gauge.font(15, 500);
  pen.textBaseline = "bottom";
  pen.textAlign = "center";
  const mark = `${limit.toFixed(0)} N`;
  const room = right - left - pen.measureText(`-${mark}`).width;
  const both = task.limits[0] && task.limits[hand.upright];
  const up = both ? `   ↑ ${force[hand.upright].toFixed(0)} N` : "";
  const text = `${both ? "→ " : ""}${value.toFixed(0)} N${up}`;
  gauge.font(17, 650);
  const marked = pen.measureText(text).width < room;
  pen.fillText(text, to(0), height - 1);
  gauge.font(15, 500);
  if (marked) for (const side of [-1, 1]) pen.fillText(side < 0 ? `-${mark}` : mark, to(side * limit), height - 1);
}

requestAnimationFrame(frame);
