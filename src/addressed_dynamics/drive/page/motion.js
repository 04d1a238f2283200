export function motionView() {
  throw new Error("not yet");
}
