// What the states of MountainCar and Acrobot look like: the pictures of the report's animations.
import { Brush, colours, prepare } from "./draw.js";

const WIDTH = 396; // of a picture as it was designed, in pixels

/** The scene in which a world can be drawn; null if its states are nothing that one sees. */
export function sceneOf(hello) {
  const names = hello.observation.map((each) => each.name);
  const actions = hello.action.names || [];
  const found = [MOUNTAIN_CAR, ACROBOT].find(
    (scene) => scene.dimensions.every((name) => names.includes(name)) && String(scene.actions) === String(actions),
  );
  if (!found) return null;
  const places = found.dimensions.map((name) => names.indexOf(name));
  return { ...found, of: (state) => places.map((place) => state[place]) };
}

/** Draw a state, with another one behind it that it is to be compared with. */
export function drawScene(canvas, scene, state, behind, colour, action) {
  const pixel = canvas.clientWidth / WIDTH;
  const context = prepare(canvas, scene.height * pixel);
  const brush = new Brush(context, [scene.origin[0] * pixel, scene.origin[1] * pixel], scene.scale * pixel, pixel);
  scene.ground(brush);
  if (behind) scene.body(brush, scene.of(behind), colours.back);
  scene.body(brush, scene.of(state), colour);
  const direction = action - (scene.actions.length >> 1);
  if (direction) scene.push(brush, scene.of(state), direction);
}

const LOWEST = -1.2, HIGHEST = 0.6, GOAL = 0.5, MARGIN = 0.09, CAR = 0.13, WHEEL = 0.026;
const height = (x) => 0.45 * Math.sin(3 * x) + 0.55;

function onTrack(x, along, above) {
  const slope = Math.atan(1.35 * Math.cos(3 * x)), [c, s] = [Math.cos(slope), Math.sin(slope)];
  return [x + along * c - above * s, height(x) + along * s + above * c];
}

const shown = (x) => Math.min(HIGHEST + MARGIN, Math.max(LOWEST - MARGIN, x));

const MOUNTAIN_CAR = {
  dimensions: ["position", "velocity"],
  actions: ["push_left", "no_push", "push_right"],
  height: 256,
  origin: [(MARGIN - LOWEST) * 200, 252],
  scale: 200,
  keys: "to push",
  ground(brush) {
    const track = Array.from({ length: 120 }, (_, i) => {
      const x = LOWEST - MARGIN + ((HIGHEST - LOWEST + 2 * MARGIN) * i) / 119;
      return [x, height(x)];
    });
    brush.polygon([...track, [track.at(-1)[0], 0], [track[0][0], 0]], colours.soft);
    brush.line(track, colours.back, 1.5);
    for (const [wall, outwards] of [[LOWEST, -1], [HIGHEST, 1]]) {
      const side = wall + (outwards * CAR) / 2; // a car is a point to its world: its middle stops at the wall
      brush.line([[side, height(side)], [side, height(side) + 0.2]], colours.back, 2);
    }
    const foot = height(GOAL);
    brush.line([[GOAL, foot], [GOAL, foot + 0.24]], colours.truth, 1.5);
    brush.polygon([[GOAL, foot + 0.24], [GOAL - 0.1, foot + 0.205], [GOAL, foot + 0.17]], colours.goal);
  },
  body(brush, [position], colour) {
    const x = shown(position), half = CAR / 2, low = WHEEL, high = 0.075;
    const outline = [[-half, low], [half, low], [half, 0.052], [0.55 * half, high], [-0.55 * half, high], [-half, 0.052]];
    brush.polygon(outline.map(([along, above]) => onTrack(x, along, above)), colour);
    const wheel = (WHEEL * brush.scale) / brush.pixel;
    for (const axle of [-0.55 * half, 0.55 * half]) {
      brush.disc(onTrack(x, axle, WHEEL), colour, 1.15 * wheel);
      brush.disc(onTrack(x, axle, WHEEL), colours.ground, 0.5 * wheel);
    }
  },
  push(brush, [position], direction) {
    const x = shown(position);
    brush.arrow([-0.05, 0.035].map((along) => onTrack(x, direction * along, 0.125)), colours.asked, 3);
  },
  off([x, v], [px, pv]) {
    return `off by ${Math.abs(px - x).toFixed(4)} m and ${Math.abs(pv - v).toFixed(5)} m/step`;
  },
  reached: ([x]) => x >= GOAL,
};

const REACH = 2.1, GOAL_HEIGHT = 1.0;
const angles = ([c1, s1, c2, s2]) => [Math.atan2(s1, c1), Math.atan2(s2, c2)];

function places(state) {
  const [first, second] = angles(state), joint = [Math.sin(first), -Math.cos(first)];
  return [joint, [joint[0] + Math.sin(first + second), joint[1] - Math.cos(first + second)]];
}

const ACROBOT = {
  dimensions: ["cos_angle_1", "sin_angle_1", "cos_angle_2", "sin_angle_2"],
  actions: ["torque_negative", "no_torque", "torque_positive"],
  height: 312,
  origin: [198, 156],
  scale: 72,
  keys: "to turn the joint",
  ground(brush) {
    for (let x = -REACH + 0.02; x < REACH; x += 0.14) {
      brush.line([[x, GOAL_HEIGHT], [x + 0.07, GOAL_HEIGHT]], colours.goal, 1.5);
    }
    brush.line([[-0.25, 0], [0.25, 0]], colours.back, 3);
  },
  body(brush, state, colour) {
    const [joint, tip] = places(state);
    brush.line([[0, 0], joint], colour, 10);
    brush.line([joint, tip], colour, 7);
    brush.disc([0, 0], colours.ground, 3);
    brush.disc(joint, colours.ground, 2.5);
  },
  push(brush, state, direction) {
    const [[x, y]] = places(state), [first, second] = angles(state);
    // From the middle of the angle between both links, on the side where neither is.
    const middle = first + (second + Math.PI) / 2 + (second > 0 ? Math.PI : 0);
    const arc = Array.from({ length: 14 }, (_, i) => {
      const turn = middle + direction * (-0.75 + (1.3 * i) / 13);
      return [x + 0.25 * Math.sin(turn), y - 0.25 * Math.cos(turn)];
    });
    brush.arrow(arc, colours.asked, 3);
  },
  off(state, predicted) {
    const a = angles(state), b = angles(predicted);
    const apart = a.map((angle, i) => Math.abs(((((b[i] - angle + Math.PI) % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI)) - Math.PI));
    return `off by ${apart[0].toFixed(3)} rad and ${apart[1].toFixed(3)} rad`;
  },
  reached: (state) => places(state)[1][1] > GOAL_HEIGHT,
};
