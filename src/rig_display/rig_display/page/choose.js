// Whose session is led: the protocols, their subjects and how far each is, and the choice of one.

const $ = (id) => document.getElementById(id);

export class Choosing {
  constructor(link) {
    this.choices = null;
    this.status = null;
    $("protocol").onchange = () => this.list();
    $("person").onchange = () => this.show(this.status);
    $("choose").onclick = () => link.say("choose", { protocol: $("protocol").value, subject: $("person").value });
  }

  offer(choices) {
    this.choices = choices;
    const names = [...new Set(choices.subjects.map(({ protocol }) => protocol))];
    fill($("protocol"), names.map((name) => [name, name]));
    this.list();
  }

  // The subjects of the protocol that is selected: of them the one that was, or else the first that can be chosen.
  list() {
    const there = this.choices.subjects.filter(({ protocol, subject }) => protocol === $("protocol").value && subject);
    fill($("person"), there.map((each) => [each.subject, `${each.subject}, ${state(each)}`]));
    const free = there.find(({ problem }) => !problem);
    if (this.selected?.problem && free) $("person").value = free.subject;
    this.show(this.status);
  }

  get selected() {
    const [protocol, subject] = [$("protocol").value, $("person").value];
    return this.choices.subjects.find((each) => each.protocol === protocol && each.subject === subject) ?? null;
  }

  // What is being begun, while the rig cannot say so itself.
  get beginning() {
    return this.choices && !this.choices.failed ? this.choices.message : "";
  }

  show(status) {
    this.status = status;
    $("study").hidden = this.choices === null || (status !== null && !status.choosing);
    if ($("study").hidden) return;
    const { selected, choices } = this;
    const session = status?.session ?? null;
    const going = status === null || ["arming", "running"].includes(status.trial.phase);
    const led = session !== null && !session.over && session.subject === selected?.subject
      && session.study === selected?.protocol;
    for (const id of ["protocol", "person"]) $(id).disabled = status === null;
    $("choose").disabled = going || led || selected === null || Boolean(selected.problem);
    $("choose").textContent = selected?.done ? "Resume" : "Begin";
    let text = choices.subjects.length ? "" : "No protocol is there.";
    if (selected?.problem) text = selected.subject ? `${selected.subject}: ${selected.problem}` : selected.problem;
    else if (selected) text = [selected.title, selected.group, state(selected)].filter(Boolean).join(" · ");
    $("chosen").textContent = text;
    $("chosen").className = `note ${selected?.problem ? "warn" : "quiet"}`;
    $("choosing").textContent = choices.message;
    $("choosing").hidden = !choices.message;
    $("choosing").className = `note ${choices.failed ? "warn" : "quiet"}`;
  }
}

function state({ done, planned, problem }) {
  if (planned && done === planned) return "finished";
  if (problem) return "cannot be led";
  return done ? `${done} of ${planned} trials` : "not begun";
}

// Options of value and text; what was selected stays so if it is still there.
function fill(select, options) {
  const was = select.value;
  select.replaceChildren(...options.map(([value, text]) => new Option(text, value, false, value === was)));
}
