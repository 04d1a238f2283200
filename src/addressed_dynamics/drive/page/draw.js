// Drawing: canvases as sharp as the screen, and a brush in the coordinates of a scene, y upwards.

export const MEMBERS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#8a7a00", "#7a7a7a"];

/** The colours of the page, read from its style; read them anew when light turns to dark. */
export const colours = {};

export function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ground", "ink", "quiet", "line", "truth", "model", "back", "soft", "shadow", "asked", "goal"]) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
}

/** Make a canvas of a shape, as many pixels as the screen has, and return its context in CSS pixels. */
export function prepare(canvas, height) {
  const width = canvas.clientWidth, ratio = Math.min(window.devicePixelRatio || 1, 3);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

export class Brush {
  /** @param pixel CSS pixels to a pixel of the picture as it was designed: widths of lines are in the latter. */
  constructor(context, [left, top], scale, pixel = 1) {
    Object.assign(this, { context, left, top, scale, pixel });
    context.lineCap = context.lineJoin = "round";
  }

  path(points) {
    const c = this.context;
    c.beginPath();
    points.forEach(([x, y], index) => c[index ? "lineTo" : "moveTo"](this.left + x * this.scale, this.top - y * this.scale));
  }

  line(points, colour, width) {
    this.path(points);
    this.context.strokeStyle = colour;
    this.context.lineWidth = width * this.pixel;
    this.context.stroke();
  }

  polygon(points, colour) {
    this.path(points);
    this.context.closePath();
    this.context.fillStyle = colour;
    this.context.fill();
  }

  disc([x, y], colour, radius) {
    this.context.beginPath();
    this.context.arc(this.left + x * this.scale, this.top - y * this.scale, radius * this.pixel, 0, 2 * Math.PI);
    this.context.fillStyle = colour;
    this.context.fill();
  }

  arrow(points, colour, width) {
    this.line(points, colour, width);
    const [[x0, y0], [x1, y1]] = points.slice(-2);
    const long = Math.hypot(x1 - x0, y1 - y0);
    if (!long) return;
    const [ax, ay] = [(x1 - x0) / long, (y1 - y0) / long], length = (3.2 * width * this.pixel) / this.scale;
    this.polygon(
      [[x1 + length * ax, y1 + length * ay],
       [x1 - 0.75 * length * ay, y1 + 0.75 * length * ax],
       [x1 + 0.75 * length * ay, y1 - 0.75 * length * ax]],
      colour,
    );
  }
}
