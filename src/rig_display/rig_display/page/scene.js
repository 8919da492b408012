// Draws a task from its description (shared_control/scene.py): points made of states, shapes at points.

import { colour } from "./canvas.js";

const PARTS = { one: () => 1, value: (v) => v, sin: Math.sin, cos: Math.cos };
const part = (state, [gain, index, of]) => gain * PARTS[of](index < 0 ? 0 : state[index]);
const sum = (terms, state) => terms.reduce((total, term) => total + part(state, term), 0);

export class Scene {
  constructor(task) {
    this.task = task;
    this.scene = task.scene;
    this.centre = this.scene.view ? sum(this.scene.view.follow, task.initial) : 0;
    const target = this.scene.target ?? [];
    this.spans = task.initial.map((value, i) => Math.max(1, Math.abs(value), Math.abs(target[i] ?? 0)));
  }

  // Where a position on the surface lies in the world [m].
  toWorld(surface, x, y) {
    const right = (x - 0.5 * surface.width) / this.scale;
    return { x: this.centre + right, y: this.bottom + (surface.height - y) / this.scale };
  }

  // Draw a state; returns where the hand takes hold, on the surface.
  draw(surface, row) {
    if (this.scene.bars) return this.drawBars(surface, row);
    const { view, points } = this.scene;
    const width = Math.max(2 * view.slack + 0.4 * view.height, 0.6 * view.height);
    this.scale = Math.min(surface.height / view.height, surface.width / width);
    this.bottom = view.bottom - 0.5 * (surface.height / this.scale - view.height);
    const follow = sum(view.follow, row.state);
    // The view moves with what would leave it otherwise; the marks on the ground show that it does.
    this.centre = Math.min(Math.max(this.centre, follow - view.slack), follow + view.slack);
    const at = (x, y) => [
      0.5 * surface.width + (x - this.centre) * this.scale,
      surface.height - (y - this.bottom) * this.scale,
    ];
    const place = Object.fromEntries(
      Object.entries(points).map(([name, [x, y]]) => [name, at(sum(x, row.state), sum(y, row.state))]),
    );
    const pen = surface.pen;
    for (const shape of this.scene.shapes) {
      pen.save();
      pen.lineCap = pen.lineJoin = "round";
      SHAPES[shape.shape](pen, shape, { at, place, scale: this.scale, surface, row, centre: this.centre });
      pen.restore();
    }
    return place[this.scene.hand.at];
  }

  drawBars(surface, row) {
    const { pen, width, height } = surface;
    const names = this.task.states;
    const step = height / (names.length + 0.5);
    const [left, right] = [0.3 * width, 0.82 * width];
    const middle = 0.5 * (left + right);
    row.state.forEach((value, i) => {
      this.spans[i] = Math.max(this.spans[i], Math.abs(value));
      const y = (i + 0.75) * step;
      const to = (v) => middle + (0.5 * (right - left) * v) / this.spans[i];
      pen.strokeStyle = colour("line");
      pen.lineWidth = 0.5 * step;
      stroke(pen, [left, y], [right, y]);
      pen.strokeStyle = row.inside ? colour("success") : colour("bob");
      pen.lineWidth = 0.4 * step;
      stroke(pen, [middle, y], [to(value), y]);
      pen.strokeStyle = colour("target");
      pen.lineWidth = 4;
      stroke(pen, [to(this.scene.target[i]), y - 0.35 * step], [to(this.scene.target[i]), y + 0.35 * step]);
      pen.fillStyle = colour("ink");
      pen.textBaseline = "middle";
      surface.font(Math.min(0.3 * step, 0.035 * width));
      pen.textAlign = "right";
      pen.fillText(`${names[i][0]} [${names[i][1]}]`, left - 12, y);
      pen.textAlign = "left";
      pen.fillText(value.toFixed(2), right + 12, y);
    });
    return [middle, 0.75 * step];
  }
}

function stroke(pen, ...points) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

const SHAPES = {
  ground(pen, shape, { at, scale, surface, centre }) {
    const y = at(0, shape.height)[1];
    pen.strokeStyle = colour("quiet");
    pen.lineWidth = Math.max(2, 0.012 * scale);
    stroke(pen, [0, y], [surface.width, y]);
    const half = (0.5 * surface.width) / scale;
    pen.fillStyle = colour("quiet");
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const size = Math.max(13, 0.026 * surface.height);
    surface.font(size);
    for (let x = Math.ceil(centre - half); x <= centre + half; x++) {
      const [px] = at(x, 0);
      stroke(pen, [px, y], [px, y + 0.6 * size]);
      pen.fillText(x === 0 ? "0 m" : String(x), px, y + 0.8 * size);
    }
  },
  sector(pen, shape, { at, place, scale, row }) {
    // Angles of the task count from upright; those of the canvas from the right, downwards.
    const [from, to] = [shape.middle - shape.half - 0.5 * Math.PI, shape.middle + shape.half - 0.5 * Math.PI];
    pen.beginPath();
    pen.moveTo(...place[shape.at]);
    pen.arc(...place[shape.at], shape.radius * scale, from, to);
    pen.closePath();
    pen.fillStyle = colour("success-fill");
    pen.fill();
    pen.strokeStyle = colour("success");
    pen.lineWidth = row.inside ? Math.max(4, 0.03 * scale) : 2;
    pen.setLineDash(row.inside ? [] : [8, 8]);
    pen.stroke();
  },
  band(pen, shape, { at, surface }) {
    const [top, bottom] = [Math.max(0, at(0, shape.top)[1]), at(0, shape.bottom)[1]];
    pen.fillStyle = colour("success-fill");
    pen.fillRect(0, top, surface.width, bottom - top);
  },
  level(pen, shape, { at, surface }) {
    const y = at(0, shape.height)[1];
    pen.strokeStyle = pen.fillStyle = colour("target");
    pen.lineWidth = 3;
    pen.setLineDash([14, 10]);
    stroke(pen, [0, y], [surface.width, y]);
    surface.font(Math.max(14, 0.03 * surface.height), 600);
    pen.fillText(`target ${shape.height.toFixed(1)} m`, 14, y - 10);
  },
  mark(pen, shape, { at, scale, surface }) {
    const [x, y] = at(shape.x, shape.height);
    const size = Math.max(0.13 * scale, 9);
    pen.fillStyle = colour("target");
    pen.beginPath();
    if (x < 0 || x > surface.width) {
      // Out of sight: which way, and how far.
      const [edge, way] = x < 0 ? [0, 1] : [surface.width, -1];
      pen.moveTo(edge + way * 8, y - 3 * size);
      pen.lineTo(edge + way * (8 + 1.8 * size), y - 4 * size);
      pen.lineTo(edge + way * (8 + 1.8 * size), y - 2 * size);
      pen.fill();
      surface.font(Math.max(14, 0.03 * surface.height), 600);
      pen.textAlign = way > 0 ? "left" : "right";
      pen.textBaseline = "middle";
      const far = Math.abs((x - 0.5 * surface.width) / scale);
      pen.fillText(`target ${far.toFixed(0)} m`, edge + way * (18 + 1.8 * size), y - 3 * size);
      return;
    }
    pen.moveTo(x, y + 0.35 * size);
    pen.lineTo(x - size, y + 1.9 * size);
    pen.lineTo(x + size, y + 1.9 * size);
    pen.fill();
  },
  stop(pen, shape, { at, scale }) {
    const [x, y] = at(shape.x, shape.height);
    pen.strokeStyle = colour("danger");
    pen.lineWidth = Math.max(5, 0.05 * scale);
    stroke(pen, [x, y - 0.3 * scale], [x, y]);
  },
  cart(pen, shape, { place, scale }) {
    const [x, y] = place[shape.at];
    const [w, h] = [shape.width * scale, shape.height * scale];
    pen.fillStyle = colour("body");
    pen.beginPath();
    pen.roundRect(x - 0.5 * w, y - 0.5 * h, w, h, 0.2 * h);
    pen.fill();
  },
  rod(pen, shape, { place, scale }) {
    pen.strokeStyle = colour("body");
    pen.lineWidth = Math.max(4, shape.width * scale);
    stroke(pen, place[shape.from], place[shape.to]);
  },
  disc(pen, shape, { place, scale }) {
    pen.beginPath();
    pen.arc(...place[shape.at], shape.radius * scale, 0, 2 * Math.PI);
    pen.fillStyle = colour("bob");
    pen.fill();
    pen.lineWidth = Math.max(2, 0.02 * scale);
    pen.strokeStyle = colour("ground");
    pen.stroke();
  },
  spring(pen, shape, { place, scale }) {
    const [[ax, ay], [bx, by]] = [place[shape.from], place[shape.to]];
    const far = Math.hypot(bx - ax, by - ay);
    if (far === 0) return;
    const long = Math.min(far, shape.rest * scale);
    const [ux, uy] = [(bx - ax) / far, (by - ay) / far];
    const turns = 8;
    const path = [[ax, ay]];
    for (let i = 1; i < 2 * turns; i++) {
      const side = (i % 2 ? 0.5 : -0.5) * shape.width * scale;
      const along = (long * i) / (2 * turns);
      path.push([ax + ux * along - uy * side, ay + uy * along + ux * side]);
    }
    path.push([ax + ux * long, ay + uy * long]);
    pen.strokeStyle = colour("body");
    pen.lineWidth = Math.max(4, 0.022 * scale);
    stroke(pen, ...path);
    pen.beginPath();
    pen.arc(...path.at(-1), 0.045 * scale, 0, 2 * Math.PI);
    pen.fillStyle = colour("body");
    pen.fill();
    // Where the foot will stand.
    pen.strokeStyle = colour("quiet");
    pen.lineWidth = 3;
    stroke(pen, [bx - 0.07 * scale, by], [bx + 0.07 * scale, by]);
  },
};
