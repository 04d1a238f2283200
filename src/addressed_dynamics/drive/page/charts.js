// States, trust and networks over the last steps.
import { colours, MEMBERS, prepare } from "./draw.js";

export const memberColour = (member) => MEMBERS[member % MEMBERS.length];

/** The last frames that were seen, oldest first. */
export class Past {
  constructor(length) {
    Object.assign(this, { length, frames: [] });
  }

  add(frame) {
    if (frame.start) this.frames = [];
    if (this.frames.at(-1)?.step === frame.step) this.frames.pop(); // the same moment, seen again
    this.frames.push(frame);
    if (this.frames.length > this.length) this.frames.shift();
  }
}

const LEFT = 44, BOTTOM = 3, TOP = 5;

/** Draw a dimension: the truth, the model, and where the truth lies in most cases. */
export function drawChart(canvas, past, index, range, tall) {
  const c = prepare(canvas, tall), wide = canvas.clientWidth;
  const [low, high] = widened(range, past.frames, index);
  const x = (i) => LEFT + ((wide - LEFT - 2) * (i + past.length - past.frames.length)) / (past.length - 1);
  const y = (value) => TOP + ((tall - TOP - BOTTOM) * (high - value)) / (high - low);
  const within = (value) => Math.min(2 * high - low, Math.max(2 * low - high, value));
  frame(c, wide, tall, [range.low, range.high]);
  c.save();
  c.beginPath();
  c.rect(LEFT, TOP - 2, wide - LEFT, tall - TOP - BOTTOM + 4);
  c.clip();
  c.globalAlpha = 0.22;
  c.fillStyle = colours.model;
  for (const run of runs(past.frames, (each) => each.interval)) {
    c.beginPath();
    run.forEach((i) => c.lineTo(x(i), y(within(past.frames[i].interval[1][index] ?? Infinity))));
    run.reverse().forEach((i) => c.lineTo(x(i), y(within(past.frames[i].interval[0][index] ?? -Infinity))));
    c.fill();
  }
  c.globalAlpha = 1;
  trace(c, past.frames, (each) => each.truth?.[index], x, y, colours.truth, 2.6);
  trace(c, past.frames, (each) => each.model[index], x, y, colours.model, 1.4);
  c.restore();
}

/** Draw how far the model is to be trusted, and above it which network each step was from. */
export function drawTrust(canvas, past, calibrated, members) {
  const tall = calibrated ? 74 : 22, c = prepare(canvas, tall), wide = canvas.clientWidth;
  const x = (i) => LEFT + ((wide - LEFT - 2) * (i + past.length - past.frames.length)) / (past.length - 1);
  const ribbon = members > 1 ? 9 : 0, step = (wide - LEFT - 2) / (past.length - 1);
  past.frames.forEach((each, i) => {
    if (each.network === null || !ribbon) return;
    c.fillStyle = memberColour(each.network);
    c.fillRect(x(i) - step, 2, step + 0.6, ribbon);
  });
  if (!calibrated) return;
  const top = ribbon + 10, y = (value) => top + (tall - top - BOTTOM) * (1 - value);
  frame(c, wide, tall, [0, 1], top);
  trace(c, past.frames, (each) => each.trust, x, y, colours.ink, 1.4);
}

function frame(c, wide, tall, [low, high], top = TOP) {
  c.strokeStyle = colours.line;
  c.lineWidth = 1;
  c.fillStyle = colours.quiet;
  c.font = "10px system-ui, sans-serif";
  c.textAlign = "right";
  for (const [place, value] of [[top, high], [tall - BOTTOM, low]]) {
    c.beginPath();
    c.moveTo(LEFT, Math.round(place) + 0.5);
    c.lineTo(wide, Math.round(place) + 0.5);
    c.stroke();
    c.textBaseline = place === top ? "top" : "bottom";
    c.fillText(short(value), LEFT - 6, place + (place === top ? -4 : 4));
  }
}

function trace(c, frames, of, x, y, colour, width) {
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.lineJoin = "round";
  for (const run of runs(frames, (each) => Number.isFinite(of(each)))) {
    c.beginPath();
    run.forEach((i) => c.lineTo(x(i), y(of(frames[i]))));
    if (run.length === 1) c.arc(x(run[0]), y(of(frames[run[0]])), 0.5, 0, 7);
    c.stroke();
  }
}

/** Numbers of frames in a row that have something. */
function runs(frames, has) {
  const found = [];
  frames.forEach((each, i) => {
    if (!has(each)) return;
    if (found.length && found.at(-1).at(-1) === i - 1) found.at(-1).push(i);
    else found.push([i]);
  });
  return found;
}

/** The range to show: the given one, or as much more as was seen. */
function widened(range, frames, index) {
  const seen = frames.flatMap((each) => [each.model[index], each.truth?.[index]]).filter(Number.isFinite);
  range.low = Math.min(range.low ?? Infinity, ...seen);
  range.high = Math.max(range.high ?? -Infinity, ...seen);
  if (!(range.low <= range.high)) return [0, 1];
  const span = range.high - range.low || Math.abs(range.high) || 1;
  return [range.low - 0.03 * span, range.high + 0.03 * span];
}

export function short(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size < 1e-9) return "0";
  if (size >= 1e4 || size < 1e-3) return value.toExponential(1);
  return String(Number(value.toPrecision(3)));
}
