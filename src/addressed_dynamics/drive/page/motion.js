// A character of 31 joints under commands, and another one that is given the same.
import { Brush, colours, prepare } from "./draw.js";
import { memberColour } from "./charts.js";
import { gamepad, holdButton } from "./hands.js";

const SIDE = 340, HEIGHT = 264; // of a picture as it was designed, in pixels
const TILE = 80, STAGE = 150, MIDDLE = 74; // cm
const DISTANCE = 900, SCALE = 1.15, ELEVATION = (16 * Math.PI) / 180;
const BEHIND = Math.PI - 0.5; // from where a person looks, and the stick is seen from, to where the camera is
const ARROW_FRAMES = 24, TRACE_FRAMES = 120;
const LIMBS = [["UpLeg", "Leg", 9.5], ["Leg", "Foot", 8], ["Foot", "ToeBase", 6.5], ["Arm", "ForeArm", 7], ["ForeArm", "Hand", 6], ["Hand", "HandIndex1", 5]];
const CONTACTS = ["LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"];
const TRUNK = ["LeftArm", "RightArm", "RightUpLeg", "LeftUpLeg"];

export function motionView(hello, held, say) {
  const place = (name) => hello.joints.indexOf(name), part = (id) => document.getElementById(id);
  const bones = ["Left", "Right"].flatMap((side) => LIMBS.map(([a, b, width]) => [place(side + a), place(side + b), width, side === "Left"]));
  const skeleton = { bones, contacts: CONTACTS.map(place), trunk: TRUNK.map(place), head: place("Head"), neck: place("Neck1"), chest: place("Neck") };
  const people = hello.bodies.map((title, index) => person(part("worlds"), title, index));
  const hands = motionHands(part("hands"), held);
  const network = chips(part("meters"), hello);
  let told = "";
  part("charts").hidden = true;
  return {
    subtitle: hello.bodies.length > 1 ? "Two models of motion under the same commands" : "A model of motion under commands",
    recordedWhat: "What the model makes of the commands is recorded, and the log says so: it is nothing that happened",
    help: help(hello),

    act() {
      const command = hands(), text = JSON.stringify(command);
      if (text === told) return;
      told = text;
      say({ type: "command", ...command });
    },

    see(frame) {
      if (frame.start) {
        told = "";
        people.forEach((each) => (each.trace = []));
      }
      frame.bodies.forEach((body, index) => people[index].see(body, frame.facing, skeleton));
    },

    draw(frame) {
      frame.bodies.forEach((body, index) => people[index].draw(body, frame, skeleton));
      network(frame);
    },
  };
}

function person(parent, title, index) {
  const figure = document.createElement("figure"), caption = document.createElement("figcaption");
  const name = document.createElement("b"), words = document.createElement("span"), canvas = document.createElement("canvas");
  figure.className = "world";
  name.textContent = title;
  name.className = index ? "name-truth" : "name-model";
  canvas.id = index ? "beside" : "model";
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `the character that ${title} moves`);
  caption.append(name, words);
  figure.append(caption, canvas);
  parent.append(figure);
  let middle = null, azimuth = null;
  return {
    trace: [],

    see(body, facing, skeleton) {
      const root = [body.root[0], MIDDLE, body.root[1]];
      const glide = (from, to) => from + 0.12 * (to - from);
      middle = this.trace.length && middle ? middle.map((value, i) => glide(value, root[i])) : root;
      const wanted = facing + BEHIND;
      azimuth = this.trace.length && azimuth !== null
        ? azimuth + 0.06 * (((((wanted - azimuth + Math.PI) % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI)) - Math.PI)
        : wanted;
      this.trace.push(body.touching.map((touches, i) => touches && [body.joints[3 * skeleton.contacts[i]], body.joints[3 * skeleton.contacts[i] + 2]]));
      if (this.trace.length > TRACE_FRAMES) this.trace.shift();
    },

    draw(body, frame, skeleton) {
      const pixel = canvas.clientWidth / SIDE;
      const context = prepare(canvas, HEIGHT * pixel);
      const brush = new Brush(context, [canvas.clientWidth / 2, (HEIGHT * pixel) / 2], pixel, pixel);
      const camera = new Camera(middle, azimuth);
      tiles(brush, camera);
      marks(brush, camera, this.trace);
      const joints = Array.from({ length: body.joints.length / 3 }, (_, i) => body.joints.slice(3 * i, 3 * i + 3));
      const shadow = joints.map(([x, , z]) => camera.seen([x, 0, z]));
      for (const [a, b, width] of skeleton.bones) brush.line([shadow[a], shadow[b]], colours.shadow, 0.9 * width * SCALE);
      if (Math.hypot(...frame.command) > 0.05) {
        const [x, z] = frame.command, at = (share) => camera.seen([body.root[0] + share * ARROW_FRAMES * x, 0, body.root[1] + share * ARROW_FRAMES * z]);
        brush.arrow([at(0.12), at(1)], colours.asked, 4);
      }
      figureOf(brush, camera, joints, body.touching, index ? colours.truth : colours.model, skeleton);
      words.textContent = body.alive ? `${body.speed.toFixed(1)} m/s` : "it has lost itself: reset (R)";
    },
  };
}

class Camera {
  constructor(target, azimuth) {
    const [s, c, up, level] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(ELEVATION), Math.cos(ELEVATION)];
    this.target = target;
    this.back = [level * s, up, level * c];
    this.right = [c, 0, -s];
    const [bx, by, bz] = this.back, [rx, ry, rz] = this.right;
    this.up = [by * rz - bz * ry, bz * rx - bx * rz, bx * ry - by * rx];
  }

  along(axis, point) {
    return axis.reduce((sum, value, i) => sum + value * (point[i] - this.target[i]), 0);
  }

  nearness(point) {
    return this.along(this.back, point);
  }

  /** Where a point is in the picture, from its middle, y upwards. */
  seen(point) {
    const away = Math.max(DISTANCE - this.nearness(point), 0.1 * DISTANCE), scale = (SCALE * DISTANCE) / away;
    return [this.along(this.right, point) * scale, this.along(this.up, point) * scale];
  }
}

/** Every other tile of the ground, on a disc around the target. */
function tiles(brush, camera) {
  const [mx, , mz] = camera.target, first = (m) => Math.floor((m - STAGE) / TILE), last = (m) => Math.floor((m + STAGE) / TILE);
  const clip = (value, most) => Math.min(most, Math.max(-most, value));
  for (let column = first(mx); column <= last(mx); column += 1) {
    const left = clip(column * TILE - mx, STAGE), right = clip((column + 1) * TILE - mx, STAGE);
    for (let row = first(mz); row <= last(mz); row += 1) {
      if ((row + column) & 1) continue;
      const edge = (far, i) => {
        const x = left + ((right - left) * i) / 12, half = Math.sqrt(Math.max(STAGE * STAGE - x * x, 0));
        return camera.seen([x + mx, 0, clip((row + far) * TILE - mz, half) + mz]);
      };
      const near = Array.from({ length: 13 }, (_, i) => edge(0, i)), far = Array.from({ length: 13 }, (_, i) => edge(1, 12 - i));
      brush.polygon([...near, ...far], colours.soft);
    }
  }
}

/** Where feet stood lately. */
function marks(brush, camera, trace) {
  const seen = new Set(), [mx, , mz] = camera.target;
  brush.context.globalAlpha = 0.5;
  for (const touches of trace) {
    for (const touch of touches) {
      if (!touch || Math.hypot(touch[0] - mx, touch[1] - mz) > STAGE) continue;
      const [x, z] = touch.map(Math.round); // whole cm: a foot that stands is one place
      if (seen.has(`${x} ${z}`)) continue;
      seen.add(`${x} ${z}`);
      brush.disc(camera.seen([x, 0, z]), colours.goal, 1.6);
    }
  }
  brush.context.globalAlpha = 1;
}

/** A person, what is nearer over what is farther away; the left side of the body is lighter. */
function figureOf(brush, camera, joints, touching, colour, skeleton) {
  const places = joints.map((joint) => camera.seen(joint)), near = joints.map((joint) => camera.nearness(joint));
  const light = mixed(colour, colours.ground);
  const parts = skeleton.bones.map(([a, b, width, left]) => ({ near: (near[a] + near[b]) / 2, a, b, width: width * SCALE, colour: left ? light : colour }));
  parts.push({ near: skeleton.trunk.reduce((sum, joint) => sum + near[joint] / 4, 0), trunk: true });
  const above = joints[skeleton.head].map((value, i) => value + 0.5 * (value - joints[skeleton.neck][i]));
  for (const part of parts.sort((one, other) => one.near - other.near)) {
    if (part.trunk) {
      trunk(brush, places, camera.seen(above), colour, skeleton);
      continue;
    }
    const line = [places[part.a], places[part.b]];
    brush.line(line, colours.ground, part.width + 2.4);
    brush.line(line, part.colour, part.width);
  }
  skeleton.contacts.forEach((joint, i) => touching[i] && brush.disc(places[joint], colours.goal, 4));
}

function trunk(brush, places, crown, colour, skeleton) {
  const outline = skeleton.trunk.map((joint) => places[joint]), closed = [...outline, outline[0]];
  brush.line(closed, colours.ground, 9 * SCALE + 2.4);
  brush.line([places[skeleton.chest], places[skeleton.head]], colour, 7 * SCALE);
  brush.polygon(outline, colour);
  brush.line(closed, colour, 9 * SCALE);
  brush.disc(crown, colours.ground, 10.5 * SCALE + 1.2);
  brush.disc(crown, colour, 10.5 * SCALE);
}

/** A colour half-way to another; both as the style writes them, with six digits. */
function mixed(colour, other) {
  const [one, two] = [colour, other].map((each) => [1, 3, 5].map((i) => parseInt(each.slice(i, i + 2), 16)));
  return `rgb(${one.map((value, i) => Math.round((value + two[i]) / 2)).join(" ")})`;
}

function chips(parent, hello) {
  if (hello.members < 2) {
    parent.hidden = true;
    return () => {};
  }
  const words = document.createElement("div"), bars = [];
  words.className = "weights";
  for (let member = 0; member < hello.members; member += 1) {
    const chip = document.createElement("span"), bar = document.createElement("i"), name = document.createElement("span");
    chip.className = "weight";
    bar.style.background = memberColour(member);
    name.textContent = `network ${member + 1}`;
    chip.append(name, bar);
    words.append(chip);
    bars.push({ chip, bar });
  }
  parent.append(words);
  return ({ weights }) => {
    if (!weights) return;
    const most = Math.max(...weights);
    bars.forEach(({ chip, bar }, member) => {
      bar.style.width = `${Math.max(2, 100 * weights[member])}%`;
      chip.classList.toggle("chosen", weights[member] === most);
    });
  };
}

/** What is asked of a character: held keys and buttons, or both sticks of a gamepad. */
function motionHands(parent, held) {
  const buttons = [["left", "turn left", "←"], ["up", "walk", "↑"], ["right", "turn right", "→"], ["down", "back", "↓"], ["run", "jog", "shift"], ["crouch", "crouch", "C"], ["strafe", "strafe", "Q"]]
    .map(([name, words, key]) => [name, holdButton(parent, held, name, words, key)]);
  held.use(...buttons.map(([name]) => name));
  return () => {
    const pad = gamepad(), strafe = held.has("strafe") || (pad?.pressed(4) ?? 0) > 0.5;
    const across = held.axis("left", "right");
    for (const [name, button] of buttons) button.classList.toggle("held", held.has(name));
    const round = (value) => Math.round(20 * Math.max(-1, Math.min(1, value))) / 20;
    return {
      right: round((strafe ? across : 0) + (pad?.axes[0] ?? 0)),
      ahead: round(held.axis("down", "up") - (pad?.axes[1] ?? 0)),
      turn: round((strafe ? 0 : -across) - (pad?.axes[2] ?? 0)),
      run: held.has("run") ? 1 : round(pad?.pressed(7) ?? 0),
      strafe: strafe ? 1 : 0,
      crouch: held.has("crouch") || (pad?.pressed(1) ?? 0) > 0.5 ? 1 : 0,
    };
  };
}

function help(hello) {
  const keys = document.createElement("span"), key = (name) => Object.assign(document.createElement("kbd"), { textContent: name });
  keys.className = "keys";
  for (const [names, does] of [[["↑"], "walks"], [["←", "→"], "turn"], [["shift"], "jogs"], [["C"], "crouches"], [["Q"], "with the arrows strafes"], [["space"], "pauses"], [["."], "makes a step"], [["R"], "resets"]]) {
    keys.append(...names.flatMap((name) => [key(name), " "]), `${does}, `);
  }
  keys.append("and a gamepad does it all. ");
  return [keys, `The model: ${hello.model}. It lives on its own predictions; the arrow is what is asked for, and green is what it says touches the ground.`];
}
