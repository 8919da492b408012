// The hand: pointer, touch, keyboard and gamepad as one force [N], sampled with the time of its newest event.

const PERIOD = 8; // ms between two messages: 125 a second, whatever the screen does
const LEAST_GAP = 3; // ms between two messages that events of a fast mouse cause
const REACH = 0.24; // of the smaller side: how far a drag goes to the limit
const DEAD = 0.08; // of a gamepad's stick
const KEYS = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  KeyA: [-1, 0], KeyD: [1, 0], KeyW: [0, 1], KeyS: [0, -1],
};

export class Hand {
  // element: what is pressed; world(x, y): a position on it in the world [m]; newest(): the newest row, or null.
  constructor(link, element, world, newest) {
    Object.assign(this, { link, element, world, newest });
    this.task = null;
    this.kind = "direct";
    this.driving = false;
    this.here = !document.hidden && document.hasFocus();
    this.pressed = null; // { id, from, to } on the element
    this.keys = new Set();
    this.event = null; // ms, the oldest event that has not been sent
    this.sent = 0;
    this.told = 0; // ms, when an event last caused a message
    this.later = null; // the timer of an event that waits for the least gap
    this.force = [0, 0, 0];
    element.addEventListener("pointerdown", (event) => this.press(event));
    // The raw events are not held back to the next frame.
    const moves = "onpointerrawupdate" in window ? "pointerrawupdate" : "pointermove";
    element.addEventListener(moves, (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(end, (event) => this.lift(event));
    }
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
    // Which of the two events of a page that is hidden comes first is not said anywhere.
    addEventListener("blur", () => this.drop(document.hidden ? "hidden" : "out of focus"));
    addEventListener("pagehide", () => this.drop("leaving"));
    addEventListener("focus", () => this.look());
    document.addEventListener("visibilitychange", () => this.look());
    setInterval(() => this.beat(), PERIOD);
  }

  // Shown does not mean in use: another window beside this one may have the focus.
  look() {
    if (document.hidden) this.drop("hidden");
    else if (!document.hasFocus()) this.drop("out of focus");
    else this.here = true;
  }

  // The page is not looked at: nothing is pushed, and the rig hears why at once.
  drop(reason) {
    this.here = false;
    this.pressed = null;
    this.keys.clear();
    this.force = [0, 0, 0];
    if (this.driving) this.link.say("idle", { reason });
  }

  place(event) {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  press(event) {
    if (event.button !== 0 || this.pressed) return;
    this.here = true;
    this.element.setPointerCapture(event.pointerId);
    const at = this.place(event);
    this.pressed = { id: event.pointerId, from: at, to: at };
    this.note(event);
  }

  move(event) {
    if (this.pressed?.id !== event.pointerId) return;
    this.pressed.to = this.place(event);
    this.note(event);
  }

  lift(event) {
    if (this.pressed?.id !== event.pointerId) return;
    this.pressed = null;
    this.note(event);
  }

  key(event, down) {
    const command = event.ctrlKey || event.altKey || event.metaKey;
    if (!(event.code in KEYS) || event.target.tagName === "INPUT" || command) return;
    event.preventDefault();
    if (down) this.keys.add(event.code);
    else this.keys.delete(event.code);
    this.hard = event.shiftKey;
    if (!event.repeat) this.note(event);
  }

  // Something happened: it goes out now, or as soon as the least gap to the event before is over.
  note(event) {
    this.event ??= event.timeStamp;
    if (this.later !== null) return;
    const wait = this.told + LEAST_GAP - performance.now();
    if (wait > 0) this.later = setTimeout(() => this.tell(), wait);
    else this.tell();
  }

  tell() {
    this.later = null;
    this.told = performance.now();
    this.send();
  }

  beat() {
    if (performance.now() - this.sent >= PERIOD - 2) this.send();
  }

  get reach() {
    return REACH * Math.min(this.element.clientWidth, this.element.clientHeight);
  }

  // Which force component up and down on the page is.
  get upright() {
    return this.task.limits[2] > 0 ? 2 : 1;
  }

  sample() {
    const limits = this.task.limits;
    const force = [0, 0, 0];
    const share = (right, up) => {
      force[0] += right * limits[0];
      force[this.upright] += up * limits[this.upright];
    };
    if (this.pressed) {
      const { from, to } = this.pressed;
      const spring = this.task.scene.hand?.spring;
      const row = this.newest();
      if (this.kind === "spring" && spring && row) {
        const { position, velocity } = spring;
        const { stiffness, damping } = this.task;
        force[0] += stiffness * (this.world(...to).x - row.state[position]) - damping * row.state[velocity];
      } else {
        share((to[0] - from[0]) / this.reach, (from[1] - to[1]) / this.reach);
      }
    }
    const strength = this.hard ? 1 : 0.5;
    for (const code of this.keys) share(KEYS[code][0] * strength, KEYS[code][1] * strength);
    for (const pad of navigator.getGamepads?.() ?? []) {
      if (!pad) continue;
      const [x, y] = pad.axes.map((value) => (Math.abs(value) < DEAD ? 0 : value));
      share(x ?? 0, -(y ?? 0));
    }
    return force.map((value, i) => Math.min(Math.max(value, -limits[i]), limits[i]));
  }

  send() {
    if (!this.task) return;
    const now = performance.now();
    this.force = this.here ? this.sample() : [0, 0, 0];
    this.sent = now;
    const age = this.event === null ? null : Math.min(Math.max(now - this.event, 0), 60000);
    this.event = null;
    if (!this.driving || !this.here) return;
    const [x, y, z] = this.force;
    this.link.say("force", { x, y, z, t: now, age });
  }

  // A short pulse where the device has one: a phone, a gamepad.
  pulse() {
    navigator.vibrate?.(30);
    for (const pad of navigator.getGamepads?.() ?? []) {
      pad?.vibrationActuator?.playEffect?.("dual-rumble", { duration: 40, strongMagnitude: 0.7, weakMagnitude: 0.3 });
    }
  }
}
