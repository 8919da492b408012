// A person at the driver's page: sees the picture, drags the mouse, knows nothing that the page does not show. The mouse
// is pressed already when this begins; it moves by pointer events like those of a real one.
(event) => {
  const LENGTH = 2; // m, the rod: gives the picture its scale
  const GRAVITY = 9.81;
  const GAINS = [-36, -15, -0.7, -2]; // of angle, rate, place, speed while it stands [m/s^2 per rad, ...]
  const STRONGEST = 12; // m/s^2
  const canvas = document.getElementById("view");
  const pen = canvas.getContext("2d");
  const style = getComputedStyle(document.documentElement);
  const rgb = (name) => style.getPropertyValue(`--${name}`).match(/[0-9a-f]{2}/g).slice(0, 3).map((h) => parseInt(h, 16));
  const [BOB, BODY, TARGET] = ["bob", "body", "target"].map(rgb);
  const ratio = canvas.width / canvas.clientWidth;
  const moves = "onpointerrawupdate" in window ? "pointerrawupdate" : "pointermove";
  const reach = 0.24 * Math.min(canvas.clientWidth, canvas.clientHeight); // the marks of the limit, 40 N
  let still = null; // the picture of the hanging pendulum: where the cart's rail is, and how long the rod
  let seen = []; // what was seen lately: time [s], angle, place

  // Middle and extent of all pixels of a colour between two heights.
  function find([r, g, b], { data, width, height }, top = 0, bottom = height) {
    let [n, sx, sy, high, left, right] = [0, 0, 0, Infinity, Infinity, -Infinity];
    for (let y = Math.max(0, Math.floor(top)); y < Math.min(height, bottom); y++) {
      for (let x = 0, i = 4 * y * width; x < width; x++, i += 4) {
        if (data[i] !== r || data[i + 1] !== g || data[i + 2] !== b) continue;
        n++;
        sx += x;
        sy += y;
        [high, left, right] = [Math.min(high, y), Math.min(left, x), Math.max(right, x)];
      }
    }
    return n ? { x: sx / n, y: sy / n, high, left, right } : null;
  }

  function look(now) {
    const picture = pen.getImageData(0, 0, canvas.width, canvas.height);
    const bob = find(BOB, picture);
    if (still === null) {
      const body = find(BODY, picture);
      if (!bob || !body) return null;
      const long = (bob.y - body.high) / 1.07; // the cart's top is 7 % of the rod above its middle
      still = { long, rail: body.high + 0.07 * long };
    }
    // The cart where the rod does not cross it: below the rail while the bob is above, and the other way about.
    const side = bob && bob.y < still.rail ? 0.06 : -0.06;
    const row = still.rail + side * still.long;
    const cart = find(BODY, picture, row - 1, row + 1);
    const mark = find(TARGET, picture, still.rail);
    if (!bob || !cart || !mark) return null;
    const x = 0.5 * (cart.left + cart.right);
    const angle = Math.atan2(bob.x - x, still.rail - bob.y);
    return { time: now / 1000, angle, place: ((x - mark.x) * LENGTH) / still.long };
  }

  const wrap = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));

  // Acceleration of the cart that one would like [m/s^2].
  function decide() {
    const [old, now] = [seen[0], seen.at(-1)];
    const step = now.time - old.time;
    const rate = wrap(now.angle - old.angle) / step;
    const speed = (now.place - old.place) / step;
    const lift = GRAVITY / LENGTH;
    const energy = 0.5 * rate * rate + lift * (Math.cos(now.angle) - 1); // none when it stands
    if (Math.abs(now.angle) < 0.7 && Math.abs(energy) < 2.5) {
      return -(GAINS[0] * now.angle + GAINS[1] * rate + GAINS[2] * now.place + GAINS[3] * speed);
    }
    const push = Math.abs(rate) < 0.05 && energy < -9 ? 6 : Math.max(-8, Math.min(8, 4 * energy)) * Math.sign(rate * Math.cos(now.angle));
    return push - 0.8 * now.place - speed;
  }

  function drag(acceleration) {
    const share = Math.max(-STRONGEST, Math.min(STRONGEST, acceleration)) / 20; // 20 m/s^2 are the limit
    const at = { clientX: event.x + share * reach, clientY: event.y, pointerId: event.id, bubbles: true };
    canvas.dispatchEvent(new PointerEvent(moves, { ...at, pointerType: "mouse", buttons: 1, button: -1 }));
  }

  function frame(now) {
    if (window.personLeaves) return;
    requestAnimationFrame(frame);
    const view = look(now);
    if (!view) return;
    seen.push(view);
    if (seen.length > 4) seen.shift();
    if (seen.length > 2) drag(decide());
  }
  requestAnimationFrame(frame);
}
