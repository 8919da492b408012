// The state at any moment, between those that came: a little behind the newest, so that there are two to go between.

const LEAST_DELAY = 5; // ms
const MOST_DELAY = 150;

export class Playback {
  constructor(task) {
    this.angles = task.angles;
    this.reset();
  }

  reset() {
    this.rows = [];
    this.offset = null; // ms, when a state of time 0 would have come had it come as fast as the fastest
    this.late = 0;
    this.delay = LEAST_DELAY;
    this.shown = -1; // s, time of the newest state that has been drawn
  }

  add(rows, now) {
    for (const [tick, time, mode, flags, missed, received, state, force] of rows) {
      if (this.rows.length && time <= this.rows.at(-1).time) this.reset(); // another trial
      const arrival = now - 1000 * time;
      // Creeps up by 1 ms in a second of states, so that clocks may drift.
      this.offset = this.offset === null ? arrival : Math.min(this.offset + 0.01, arrival);
      this.late = Math.max(0.995 * this.late, arrival - this.offset);
      const inside = Boolean(flags & 1);
      this.rows.push({ tick, time, mode, inside, outcome: flags >> 2, missed, received, state, force });
    }
    if (this.rows.length > 1000) this.rows.splice(0, 500);
  }

  get newest() {
    return this.rows.at(-1) ?? null;
  }

  // The state to draw now, and in `passed` the rows that are shown for the first time.
  at(now) {
    if (!this.rows.length) return null;
    const wanted = Math.min(Math.max(this.late + 1, LEAST_DELAY), MOST_DELAY);
    this.delay += Math.max(-0.2, Math.min(0.5, wanted - this.delay));
    const time = (now - this.offset - this.delay) / 1000;
    let index = this.rows.length - 1;
    while (index > 0 && this.rows[index].time > time) index--;
    const before = this.rows[index];
    const after = this.rows[index + 1];
    const passed = this.rows.slice(Math.max(0, index - 20), index + 1).filter((row) => row.time > this.shown);
    this.shown = Math.max(this.shown, before.time);
    if (!after || time <= before.time) return { ...before, time: before.time, passed };
    const share = (time - before.time) / (after.time - before.time);
    const state = before.state.map((value, i) => {
      let step = after.state[i] - value;
      if (this.angles[i] && Math.abs(step) > Math.PI) step -= 2 * Math.PI * Math.round(step / (2 * Math.PI));
      return value + share * step;
    });
    return { ...before, state, time, passed };
  }
}
