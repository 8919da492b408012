// The socket to the rig: comes back by itself, knows the rig's clock, measures what the page shows.

const SYNC_PERIOD = 1000; // ms
const SILENCE = 3000; // ms without a word until a link counts as lost; the rig speaks five times a second
const RETRY = 500; // ms

export class Link extends EventTarget {
  constructor(role) {
    super();
    this.role = role;
    this.open = false;
    this.stopping = false; // an emergency stop was pressed, and the rig has not said that it holds
    this.roundTrip = NaN; // ms, the best of the last ones
    this.offset = 0; // ms, the rig's clock minus performance.now()
    this.drawn = []; // ms, state at the rig to drawn
    this.frames = 0;
    this.trips = [];
    this.connect();
    setInterval(() => this.measure(), SYNC_PERIOD);
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.heard = performance.now();
    this.socket = new WebSocket(`${scheme}//${location.host}/socket?as=${this.role}`);
    this.socket.onopen = () => {
      this.open = true;
      this.trips = [];
      this.say("sync", { t: performance.now() });
      this.dispatchEvent(new Event("open"));
      if (this.stopping) this.say("stop");
    };
    this.socket.onmessage = (event) => this.hear(JSON.parse(event.data), performance.now());
    this.socket.onclose = (event) => this.lose(event.reason);
  }

  // The link is gone, or is as good as gone; the socket may not know that yet.
  lose(reason) {
    this.socket.onopen = this.socket.onmessage = this.socket.onclose = null;
    this.socket.close();
    this.open = false;
    this.dispatchEvent(new CustomEvent("closed", { detail: reason }));
    setTimeout(() => this.connect(), RETRY);
    this.heard = Infinity; // until it is tried again
  }

  say(type, fields = {}) {
    if (this.open) this.socket.send(JSON.stringify({ type, ...fields }));
  }

  // Emergency stop. It is said again on every new connection until the rig says that it holds.
  stop() {
    this.stopping = true;
    this.say("stop");
    this.dispatchEvent(new Event("stopping"));
  }

  hear(message, now) {
    this.heard = now;
    if (message.type === "status" && message.hand.stopped) this.stopping = false;
    if (message.type === "sync") {
      // The fastest of the last exchanges says best how the clocks stand.
      this.trips.push({ trip: now - message.t, offset: message.now * 1e-6 - 0.5 * (now + message.t) });
      if (this.trips.length > 10) this.trips.shift();
      const best = this.trips.reduce((a, b) => (b.trip < a.trip ? b : a));
      [this.roundTrip, this.offset] = [best.trip, best.offset];
      return;
    }
    this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
  }

  // What the rig's clock [ns] was at a moment of this page's clock [ms].
  toPage(nanoseconds) {
    return nanoseconds * 1e-6 - this.offset;
  }

  measure() {
    if (performance.now() - this.heard > SILENCE) this.lose("");
    this.say("sync", { t: performance.now() });
    const sorted = this.drawn.sort((a, b) => a - b);
    const at = (share) => Math.max(0, Math.min(sorted[Math.ceil(share * sorted.length) - 1], 60000));
    if (sorted.length && Number.isFinite(this.roundTrip)) {
      const drawn = { drawn50: at(0.5), drawn99: at(0.99), drawnmax: at(1) };
      this.say("stats", { rtt: this.roundTrip, ...drawn, fps: Math.min(this.frames, 1000) });
    }
    this.drawn = [];
    this.frames = 0;
  }
}
