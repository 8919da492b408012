// A strip of the last seconds: lines, and dots with a colour and a sign each.

import { Surface, colour } from "./canvas.js";

const SPAN = 10; // s

export class Plot {
  // series: [{ colour, line, dots }], the points of each filled by `add`; least: the smallest range.
  constructor(canvas, series, least, { zero = true } = {}) {
    this.surface = new Surface(canvas);
    this.series = series.map((each) => ({ ...each, points: [] }));
    this.least = least;
    this.zero = zero;
  }

  clear() {
    for (const each of this.series) each.points = [];
  }

  // kind: for dots, which of three signs.
  add(index, time, value, kind = 0) {
    if (value === null) return;
    const points = this.series[index].points;
    points.push([time, value, kind]);
    if (points.length > 2 * SPAN * 100) points.splice(0, SPAN * 100);
  }

  draw() {
    if (!this.surface.begin()) return;
    const { pen, width, height } = this.surface;
    const end = Math.max(SPAN, ...this.series.map(({ points }) => points.at(-1)?.[0] ?? 0));
    const shown = this.series.map(({ points }) => points.filter(([time]) => time >= end - SPAN));
    let [low, high] = this.zero ? [0, 0] : [Infinity, -Infinity];
    for (const [, value] of shown.flat()) [low, high] = [Math.min(low, value), Math.max(high, value)];
    if (low > high) [low, high] = [0, 0];
    const pad = Math.max(0.5 * (this.least - (high - low)), 0.06 * (high - low));
    [low, high] = [low === 0 && this.zero ? 0 : low - pad, high + pad];
    const [left, right, top, bottom] = [52, width - 6, 8, height - 22];
    const x = (time) => right - ((end - time) / SPAN) * (right - left);
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    this.axes(pen, { low, high, end, left, right, top, bottom, x, y });
    pen.lineWidth = 2;
    this.series.forEach((each, i) => {
      for (const [time, value, kind] of each.dots ? shown[i] : []) {
        DOTS[kind](pen, x(time), y(value), colour(each.dots[kind]));
      }
      if (!each.line) return;
      pen.strokeStyle = colour(each.line);
      pen.setLineDash(each.dash ?? []);
      pen.beginPath();
      for (const [time, value] of shown[i]) pen.lineTo(x(time), y(value));
      pen.stroke();
      pen.setLineDash([]);
    });
  }

  axes(pen, { low, high, end, left, right, top, bottom, x, y }) {
    pen.fillStyle = colour("quiet");
    pen.strokeStyle = colour("line");
    pen.lineWidth = 1;
    this.surface.font(12);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const rough = (high - low) / 4;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
    for (let i = Math.ceil(low / step); i * step <= high; i++) {
      const at = Math.round(y(i * step)) + 0.5;
      pen.beginPath();
      pen.moveTo(left, at);
      pen.lineTo(right, at);
      pen.stroke();
      pen.fillText(Number((i * step).toPrecision(6)).toLocaleString("en"), left - 6, at);
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (let s = Math.ceil((end - SPAN) / 2) * 2; s <= end; s += 2) {
      pen.fillText(`${s} s`, Math.min(x(s), right - 10), bottom + 6);
    }
  }
}

const DOTS = [
  (pen, x, y, tint) => {
    pen.fillStyle = tint;
    pen.fillRect(x - 1.5, y - 1.5, 3, 3);
  },
  (pen, x, y, tint) => {
    pen.strokeStyle = tint;
    pen.beginPath();
    pen.moveTo(x - 3, y - 3);
    pen.lineTo(x + 3, y + 3);
    pen.moveTo(x - 3, y + 3);
    pen.lineTo(x + 3, y - 3);
    pen.stroke();
  },
  (pen, x, y, tint) => {
    pen.fillStyle = tint;
    pen.beginPath();
    pen.moveTo(x, y - 4);
    pen.lineTo(x + 4, y);
    pen.lineTo(x, y + 4);
    pen.lineTo(x - 4, y);
    pen.fill();
  },
];
