// The page: a socket to the server, what a person does, what there is to see.
import { readColours } from "./draw.js";
import { Held } from "./hands.js";
import { transitionsView } from "./transitions.js";
import { motionView } from "./motion.js";

const part = (id) => document.getElementById(id);
/** For who looks in from outside, as a test does. */
const seen = (window.drive = { frames: 0, drawn: 0, hello: null, frame: null });

const held = new Held();
let socket = null, view = null, paused = false, recording = false, drawn = null, over = false;

const say = (message) => socket?.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));

function notice(words, kind = "") {
  part("notice").textContent = words;
  part("notice").className = `notice ${kind}`;
}

function stopped(words) {
  over = true;
  part("subtitle").textContent = words;
  part("subtitle").classList.add("notice");
  for (const button of document.querySelectorAll("button, input")) button.disabled = true;
}

const HEARD = {
  hello(message) {
    seen.hello = message;
    document.title = `${message.title}: drive`;
    part("title").textContent = message.title;
    part("drive").hidden = false;
    readColours();
    view = (message.kind === "motion" ? motionView : transitionsView)(message, held, say, notice);
    part("subtitle").textContent = view.subtitle;
    part("help").append(...view.help);
    part("sync").hidden = !message.environment;
    status(false, message.rate);
    setSpeed(message.rate);
  },
  frame(message) {
    seen.frames += 1;
    seen.frame = message;
    view.see(message);
    if (message.recorded !== null && recording) part("record-words").textContent = `Recording, ${message.recorded} steps`;
  },
  status: (message) => status(message.paused, message.rate),
  refused: (message) => notice(message.message),
  recording(message) {
    recording = message.on;
    part("record").classList.toggle("on", message.on);
    part("record-words").textContent = message.on ? "Recording" : "Record";
    if (message.on) notice(view.recordedWhat, "said");
    else if (message.path) notice(`${message.count} steps are in ${message.path}`, "good");
    else if (message.count === 0) notice("Nothing was recorded", "said");
  },
  fatal: (message) => stopped(message.message),
};

function status(nowPaused, rate) {
  paused = nowPaused;
  part("pause").textContent = paused ? "Go on" : "Pause";
  const real = rate * seen.hello.step_seconds;
  const times = Math.abs(real - 1) < 0.02 ? "real time" : `${real.toPrecision(2)} × real time`;
  part("speed-words").textContent = `${rate < 10 ? rate.toFixed(1) : Math.round(rate)} steps/s, ${times}`;
}

// The slider goes from 0.5 to 60 steps a second, by ratios.
const SLOWEST = 0.5, FASTEST = 60;
const setSpeed = (rate) => (part("speed").value = Math.log(rate / SLOWEST) / Math.log(FASTEST / SLOWEST));
const speed = () => SLOWEST * (FASTEST / SLOWEST) ** Number(part("speed").value);

const BUTTONS = {
  pause: () => say({ type: paused ? "resume" : "pause" }),
  step: () => say({ type: "step" }),
  reset() {
    notice("");
    say({ type: "reset" });
  },
  sync: () => say({ type: "sync" }),
  record: () => say({ type: recording ? "stop" : "record" }),
};
const KEYS = { Space: "pause", Period: "step", KeyR: "reset", KeyT: "sync", KeyM: "record" };

for (const [id, press] of Object.entries(BUTTONS)) {
  part(id).addEventListener("click", () => {
    press();
    part(id).blur(); // or the space bar would press it again
  });
}
part("speed").addEventListener("input", () => say({ type: "speed", rate: speed() }));
part("speed").addEventListener("pointerup", () => part("speed").blur());
addEventListener("keydown", (event) => {
  const name = KEYS[event.code];
  if (!name || event.ctrlKey || event.metaKey || event.altKey || !view) return;
  if (event.code === "Space" && event.target.closest("button")) return; // it presses that
  event.preventDefault();
  if (!(event.repeat && name !== "step") && !part(name).hidden) BUTTONS[name]();
});
// Who cannot see what they drive should not go on driving.
document.addEventListener("visibilitychange", () => document.hidden && !paused && say({ type: "pause" }));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readColours();
  drawn = null;
});
addEventListener("resize", () => (drawn = null));

function loop() {
  if (view && !over) view.act();
  if (view && seen.frame && drawn !== seen.frame) {
    view.draw(seen.frame);
    drawn = seen.frame;
    seen.drawn += 1;
  }
  requestAnimationFrame(loop);
}

if (!("WebSocket" in window)) {
  stopped("This browser has no WebSocket, over which a drive goes; take a newer one.");
} else {
  socket = new WebSocket(`ws://${location.host}/drive`);
  socket.addEventListener("message", (event) => {
    const message = JSON.parse(event.data);
    HEARD[message.type]?.(message);
  });
  socket.addEventListener("close", () => over || stopped("The server has stopped. Start it again and reload this page."));
  requestAnimationFrame(loop);
}
