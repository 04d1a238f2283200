// What a person does: keys, buttons, sliders and gamepad, as an action of the world that is driven.
import { short } from "./charts.js";

const KEYS = {
  ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down",
  KeyA: "left", KeyD: "right", KeyW: "up", KeyS: "down",
  ShiftLeft: "run", ShiftRight: "run", KeyC: "crouch", KeyQ: "strafe",
};
const DEAD = 0.25; // how far a stick must be pushed

/** What is held at present: keys and buttons of the page by name, and the gamepad's sticks. */
export class Held {
  constructor() {
    this.names = new Set();
    this.used = new Set();
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
    addEventListener("blur", () => this.release());
  }

  key(event, down) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const digit = /^Digit([1-9])$/.exec(event.code);
    const name = digit ? `number-${digit[1] - 1}` : KEYS[event.code];
    if (!this.used.has(name)) return;
    if (document.activeElement?.type === "range") document.activeElement.blur();
    event.preventDefault();
    this.set(name, down);
  }

  /** Say which names do something here: other keys are left to the browser. */
  use(...names) {
    names.forEach((name) => this.used.add(name));
  }

  set(name, down) {
    if (down) this.names.add(name);
    else this.names.delete(name);
  }

  release() {
    this.names.clear();
  }

  has(name) {
    return this.names.has(name);
  }

  /** -1, 0 or 1. */
  axis(less, more) {
    return Number(this.has(more)) - Number(this.has(less));
  }
}

/** The first gamepad's sticks and buttons; null if there is none. */
export function gamepad() {
  const pad = [...(navigator.getGamepads?.() ?? [])].find(Boolean);
  if (!pad) return null;
  const stick = (index) => (Math.abs(pad.axes[index] ?? 0) > DEAD ? pad.axes[index] : 0);
  return { axes: [0, 1, 2, 3].map(stick), pressed: (index) => pad.buttons[index]?.value ?? 0 };
}

/** A button that is held as long as a finger or the mouse is on it, or a key that presses buttons is down. */
export function holdButton(parent, held, name, words, key) {
  const button = document.createElement("button");
  button.append(words);
  if (key) {
    const hint = document.createElement("kbd");
    hint.textContent = key;
    button.append(hint);
  }
  const set = (down) => (event) => {
    event.preventDefault();
    held.set(name, down);
  };
  button.addEventListener("pointerdown", set(true));
  for (const end of ["pointerup", "pointerleave", "pointercancel", "contextmenu", "blur"]) button.addEventListener(end, set(false));
  for (const [event, down] of [["keydown", true], ["keyup", false]]) {
    button.addEventListener(event, (key) => ["Space", "Enter"].includes(key.code) && set(down)(key));
  }
  parent.append(button);
  return button;
}

/** A slider with its name and value. */
export function slider(parent, dimension, kind, changed) {
  const label = document.createElement("label"), name = document.createElement("span");
  const value = document.createElement("output"), input = document.createElement("input");
  label.className = `slider ${kind}`;
  name.textContent = spoken(dimension.name);
  Object.assign(input, { type: "range", min: dimension.low ?? -1, max: dimension.high ?? 1, step: "any" });
  const show = () => (value.textContent = `${short(Number(input.value))} ${dimension.unit}`);
  input.addEventListener("input", () => {
    show();
    changed(Number(input.value));
  });
  label.append(name, value, input);
  parent.append(label);
  return {
    input,
    set(number) {
      if (number === null || Number(input.value) === number) return;
      input.value = number;
      show();
    },
  };
}

export const spoken = (name) => name.replaceAll("_", " ");

/** How to act in a world with some actions: the choice among them, with what it needs in the page. */
export function discreteHands(parent, action, held) {
  const { names, neutral } = action, last = names.length - 1;
  const of = (pattern, otherwise) => {
    const found = names.findIndex((name) => pattern.test(name));
    return found < 0 ? otherwise : found;
  };
  const left = of(/left|negative|back/, 0), right = of(/right|positive|forward/, last), up = of(/up|main|fire/, -1);
  const arrows = { [left]: "←", [right]: "→", ...(up >= 0 ? { [up]: "↑" } : {}) };
  const buttons = names.map((name, index) =>
    holdButton(parent, held, `number-${index}`, spoken(name), arrows[index] ?? (index < 9 ? String(index + 1) : "")),
  );
  held.use("left", "right", ...(up >= 0 ? ["up"] : []), ...names.map((_, index) => `number-${index}`));
  let before = neutral;
  return () => {
    let chosen = names.length > 2 ? neutral : before; // between two there is no rest
    const pad = gamepad(), across = held.axis("left", "right") || Math.sign(pad?.axes[0] ?? 0);
    if (across) chosen = across < 0 ? left : right;
    if (up >= 0 && (held.has("up") || pad?.pressed(0))) chosen = up;
    names.forEach((_, index) => {
      if (held.has(`number-${index}`)) chosen = index;
    });
    buttons.forEach((button, index) => {
      button.classList.toggle("held", index === chosen);
      button.setAttribute("aria-pressed", index === chosen);
    });
    before = chosen;
    return chosen;
  };
}

/** The same for actions of some components: a slider for each, arrows and sticks for the first two. */
export function continuousHands(parent, action, held) {
  const { dimensions, neutral } = action, values = [...neutral], steered = dimensions.map(() => false);
  const sliders = dimensions.map((dimension, index) =>
    slider(parent, dimension, "action", (value) => (values[index] = value)),
  );
  sliders.forEach((each, index) => each.set(neutral[index]));
  held.use("left", "right", "run", ...(dimensions.length > 1 ? ["up", "down"] : []));
  return () => {
    const pad = gamepad();
    const keys = [held.axis("left", "right"), held.axis("down", "up")];
    dimensions.forEach((dimension, index) => {
      const stick = (pad?.axes[index] ?? 0) * (index % 2 ? -1 : 1); // up is negative on a gamepad
      const push = (keys[index] || stick) * (held.has("run") ? 0.5 : 1);
      if (push) {
        const bound = push < 0 ? dimension.low ?? -1 : dimension.high ?? 1;
        values[index] = neutral[index] + Math.abs(push) * (bound - neutral[index]);
        steered[index] = true;
      } else if (steered[index]) {
        values[index] = neutral[index];
        steered[index] = false;
      }
      sliders[index].set(values[index]);
    });
    return [...values];
  };
}
