// Worlds of states and actions: the truth and the model side by side, or the model alone.
import { drawChart, drawTrust, memberColour, Past, short } from "./charts.js";
import { colours } from "./draw.js";
import { continuousHands, discreteHands, slider, spoken } from "./hands.js";
import { drawScene, sceneOf } from "./scenes.js";

const WINDOW_SECONDS = 10;

const ENDED = {
  terminated: "The episode has ended. Reset (R) starts anew.",
  truncated: "The episode is over. Reset (R) starts anew.",
  exogenous: "What was recorded beside this start ends here. Reset (R), or take the sliders.",
  not_finite: "The model predicts no number any more. Reset (R) starts anew.",
};

export function transitionsView(hello, held, say, notice) {
  const scene = sceneOf(hello), truth = hello.environment !== null;
  const length = Math.min(400, Math.max(120, Math.round(WINDOW_SECONDS / hello.step_seconds)));
  const past = new Past(length), part = (id) => document.getElementById(id);
  const pictures = scene ? worlds(part("worlds"), truth) : null;
  if (!pictures) {
    part("worlds").replaceWith(part("charts")); // they are then what there is to see
    part("charts").classList.add("alone");
  }
  const hands = (hello.action.kind === "discrete" ? discreteHands : continuousHands)(part("hands"), hello.action, held);
  const beside = exogenousHands(part("hands"), hello.exogenous, say);
  const meter = meters(part("meters"), hello);
  const charts = hello.observation.map((dimension) => chart(part("charts"), dimension, truth, !pictures));
  let acted = JSON.stringify(hello.action.neutral), ended = "";

  return {
    subtitle: truth ? `The model beside ${hello.environment}, under the same actions` : "The model alone, from a recorded start",
    recordedWhat: truth
      ? "What really happens is recorded, not what the model makes of it"
      : "What the model predicts is recorded, and the log says so: it is nothing that happened",
    help: help(hello, scene, truth),

    act() {
      const action = hands(), text = JSON.stringify(action);
      if (text === acted) return;
      acted = text;
      say({ type: "act", action });
    },

    see(frame) {
      if (frame.start) acted = JSON.stringify(frame.action);
      past.add(frame);
      if (frame.ended && frame.ended !== ended) notice(ENDED[frame.ended], "said");
      else if (!frame.ended && ended) notice("");
      ended = frame.ended;
    },

    draw(frame) {
      const action = typeof frame.action === "number" ? frame.action : 0;
      if (pictures) {
        if (truth) {
          drawScene(pictures.truth.canvas, scene, frame.truth, null, colours.truth, action);
          pictures.truth.words.textContent =
            `${(frame.step * hello.step_seconds).toFixed(2)} s${scene.reached(scene.of(frame.truth)) ? ", goal reached" : ""}`;
        }
        drawScene(pictures.model.canvas, scene, frame.model, frame.truth, colours.model, action);
        pictures.model.words.textContent = truth
          ? scene.off(scene.of(frame.truth), scene.of(frame.model))
          : `${(frame.step * hello.step_seconds).toFixed(2)} s`;
      }
      meter(frame, past);
      beside(frame);
      charts.forEach((each, index) => each(frame, past, index));
    },
  };
}

function figure(parent, kind, name, words) {
  const figure = document.createElement("figure"), caption = document.createElement("figcaption");
  const title = document.createElement("b"), right = document.createElement("span"), canvas = document.createElement("canvas");
  figure.className = kind;
  title.textContent = name;
  right.textContent = words;
  caption.append(title, right);
  figure.append(caption, canvas);
  parent.append(figure);
  return { figure, caption, title, words: right, canvas };
}

function worlds(parent, truth) {
  const made = {};
  for (const name of truth ? ["truth", "model"] : ["model"]) {
    made[name] = figure(parent, "world", name, "");
    made[name].title.className = `name-${name}`;
    made[name].canvas.id = name;
    made[name].canvas.setAttribute("role", "img");
    made[name].canvas.setAttribute("aria-label", name === "truth" ? "what really happens" : "what the model makes of it");
  }
  return made;
}

function meters(parent, hello) {
  const { figure: box, caption, title, words, canvas } = figure(parent, "meter", "", "");
  if (!hello.calibrated && hello.members === 1) {
    box.hidden = true;
    return () => {};
  }
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "trust and chosen network over the last steps");
  words.className = "chips";
  const chips = Array.from({ length: hello.members > 1 ? hello.members : 0 }, (_, member) => {
    const chip = document.createElement("span"), dot = document.createElement("i");
    chip.className = "chip";
    dot.style.background = memberColour(member);
    chip.append(dot, hello.members > 4 ? String(member + 1) : `network ${member + 1}`);
    words.append(chip);
    return chip;
  });
  caption.title = "Trust: the share of validation points that were less usual; 0 is beyond all of them";
  return (frame, past) => {
    if (frame.network !== null) chips.forEach((chip, member) => chip.classList.toggle("chosen", member === frame.network));
    title.textContent = hello.calibrated
      ? `trust ${frame.trust === null ? "–" : frame.trust.toFixed(2)}`
      : "network";
    drawTrust(canvas, past, hello.calibrated, hello.members);
  };
}

function chart(parent, dimension, truth, alone) {
  const unit = dimension.unit ? ` (${dimension.unit})` : "", range = { low: dimension.low, high: dimension.high };
  const { title, words, canvas } = figure(parent, "chart", "", "");
  title.replaceWith(Object.assign(document.createElement("span"), { textContent: spoken(dimension.name) + unit }));
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${spoken(dimension.name)} over the last steps`);
  return (frame, past, index) => {
    const own = short(frame.model[index]);
    words.textContent = truth ? `truth ${short(frame.truth[index])}, model ${own}` : own;
    drawChart(canvas, past, index, range, alone ? 150 : 92);
  };
}

/** Sliders for what acts on the world from outside, and whether it is replayed instead. */
function exogenousHands(parent, dimensions, say) {
  if (!dimensions.length) return () => {};
  let replayed = true;
  const values = dimensions.map((each) => Math.min(each.high ?? 0, Math.max(each.low ?? 0, 0)));
  const tick = document.createElement("input"), label = document.createElement("label");
  const tell = () => say({ type: "exogenous", values: replayed ? null : values });
  tick.type = "checkbox";
  tick.checked = true;
  tick.addEventListener("change", () => {
    replayed = tick.checked;
    tell();
  });
  const sliders = dimensions.map((dimension, index) =>
    slider(parent, dimension, "exogenous", (value) => {
      values[index] = value;
      replayed = tick.checked = false;
      tell();
    }),
  );
  label.className = "replay";
  label.append(tick, "as recorded");
  parent.append(label);
  return (frame) => {
    if (!replayed) return;
    frame.exogenous.forEach((value, index) => {
      values[index] = value ?? 0;
      sliders[index].set(value);
    });
  };
}

function help(hello, scene, truth) {
  const keys = document.createElement("span"), words = [];
  const key = (name) => Object.assign(document.createElement("kbd"), { textContent: name });
  keys.className = "keys";
  const arrows = hello.action.kind === "discrete" || hello.action.dimensions.length < 2 ? ["←", "→"] : ["←", "→", "↑", "↓"];
  keys.append(...arrows.flatMap((each) => [key(each), " "]), `or a gamepad ${scene?.keys ?? "to act"}, `);
  for (const [name, does] of [["space", "to pause"], [".", "for a step"], ["R", "to reset"], ...(truth ? [["T", "to give the model the true state"]] : []), ["M", "to record"]]) {
    keys.append(key(name), ` ${does}, `);
  }
  keys.lastChild.textContent = keys.lastChild.textContent.replace(", ", ". ");
  words.push(keys, `The model: ${hello.model}. `);
  if (truth) words.push("It is given the first state and the actions, and lives on its own predictions. ");
  if (hello.coverage) words.push(`Bands: where the truth lies in ${Math.round(100 * hello.coverage)} of 100 cases.`);
  return words;
}
