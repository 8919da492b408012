// What is said in the same words on both pages.

export const VERDICTS = ["accepted", "rejected", "replaced"];
export const SIGNS = ["●", "✕", "◆"];

export function where(trial) {
  const parts = [];
  if (trial.subject) parts.push(trial.subject);
  if (trial.set) parts.push(/^set/i.test(trial.set) ? trial.set : `set ${trial.set}`);
  if (trial.trial) parts.push(`trial ${trial.trial}`);
  return parts.join(" · ");
}

export function outcome(code) {
  return ["", "Success", "Fallen out of the task"][code] ?? "";
}

// Emergency stop by key: Esc everywhere, the space bar where one does not type.
export function onStopKey(stop) {
  addEventListener("keydown", (event) => {
    const typing = ["INPUT", "SELECT"].includes(event.target.tagName);
    if (event.code !== "Escape" && (event.code !== "Space" || typing)) return;
    event.preventDefault();
    stop();
  });
}
