// Draws the charts of the page from the numbers beside them. Nothing is loaded from elsewhere.
(() => {
  "use strict";
  const SVG = "http://www.w3.org/2000/svg";
  const FAINT = "#8c8c8c", GRID = "#e6e6e6", INK = "#222222";
  const WIDTHS = { line: 1.6, dashed: 1.6, thick: 4 };
  const SUPERSCRIPT = "⁰¹²³⁴⁵⁶⁷⁸⁹";

  function add(parent, name, attributes, text) {
    const svg = parent.namespaceURI === SVG || name === "svg";
    const element = svg ? document.createElementNS(SVG, name) : document.createElement(name);
    for (const key in attributes) element.setAttribute(key, attributes[key]);
    if (text !== undefined) element.textContent = text;
    parent.appendChild(element);
    return element;
  }

  function power(exponent) {
    if (exponent >= -3 && exponent <= 4) return String(Number(`1e${exponent}`));
    return raised(exponent);
  }

  function raised(exponent) {
    const digits = [...String(Math.abs(exponent))].map((digit) => SUPERSCRIPT[digit]).join("");
    return `10${exponent < 0 ? "⁻" : ""}${digits}`;
  }

  function words(value) {
    if (value === null || value === undefined) return "–";
    if (value === 0) return "0";
    const size = Math.abs(value);
    if (size < 1e-3 || size >= 1e5) {
      const exponent = Math.floor(Math.log10(size));
      return `${(value / 10 ** exponent).toPrecision(3)} × ${raised(exponent)}`;
    }
    return String(Number(value.toPrecision(3)));
  }

  // An axis: where a value is between 0 and 1, and which values have a mark.
  function axis(values, logarithmic) {
    let known = values.filter((value) => value !== null && (!logarithmic || value > 0));
    if (!known.length) known = [0.1, 1];
    let low = Math.min(...known), high = Math.max(...known);
    if (logarithmic) {
      if (high / low < 10) { low /= 2; high *= 2; }
      const from = Math.log10(low), to = Math.log10(high);
      const stride = Math.ceil((to - from) / 6), ticks = [];
      for (let each = Math.ceil(from); each <= to; each += stride) ticks.push([10 ** each, power(each)]);
      if (ticks.length < 2) {
        ticks.length = 0;
        for (const each of [1, 2, 5, 10, 20, 50]) {
          const value = each * 10 ** Math.floor(from);
          if (value >= low && value <= high) ticks.push([value, words(value)]);
        }
      }
      return { at: (value) => (value > 0 ? (Math.log10(value) - from) / (to - from) : 0), ticks };
    }
    if (high === low) { high += 1; low -= 1; }
    const rough = (high - low) / 5, unit = 10 ** Math.floor(Math.log10(rough));
    const stride = [1, 2, 5, 10].map((each) => each * unit).find((each) => each >= rough);
    const ticks = [];
    for (let each = Math.ceil(low / stride); each * stride <= high * (1 + 1e-9); each++) {
      ticks.push([each * stride, words(each * stride)]);
    }
    return { at: (value) => (value - low) / (high - low), ticks };
  }

  class Chart {
    constructor(figure) {
      this.figure = figure;
      this.data = JSON.parse(figure.querySelector("script").textContent);
      this.shown = {};
      for (const view of this.data.views) {
        for (const line of view.lines) if (!(line.name in this.shown)) this.shown[line.name] = line.shown;
      }
      this.box = figure.querySelector(".chart");
      this.choose();
      this.canvas = add(this.box, "svg", { tabindex: 0, role: "img", "aria-label": this.data.alternative });
      this.readout = add(this.box, "p", { class: "readout", "aria-live": "polite" });
      this.legend = add(this.box, "div", { class: "legend" });
      this.canvas.addEventListener("pointermove", (event) => this.point(event));
      this.canvas.addEventListener("pointerdown", (event) => this.point(event));
      this.canvas.addEventListener("pointerleave", () => this.read(null));
      this.canvas.addEventListener("keydown", (event) => this.step(event));
      this.draw();
    }

    choose() {
      this.selects = this.data.choices.map((title, index) => {
        const label = add(this.box, "label", {}, `${title} `);
        const select = add(label, "select", {});
        for (const value of new Set(this.data.views.map((view) => view.choice[index]))) {
          add(select, "option", { value }, value);
        }
        select.addEventListener("change", () => this.draw());
        return select;
      });
    }

    get view() {
      const chosen = this.selects.map((select) => select.value);
      const same = (view) => view.choice.every((value, index) => value === chosen[index]);
      return this.data.views.find(same) || this.data.views.find((view) => view.choice[0] === chosen[0]);
    }

    get lines() { return this.view.lines.filter((line) => this.shown[line.name]); }

    draw() {
      const width = Math.max(280, this.box.clientWidth || 640), ranges = this.data.form === "ranges";
      const lines = this.lines, view = this.view;
      const height = ranges ? 50 + 22 * lines.length : this.data.height;
      this.canvas.replaceChildren();
      this.canvas.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.size = { width, height, left: ranges ? Math.min(230, width * 0.42) : 58, right: 24, top: 22, bottom: 38 };
      const values = lines.flatMap((line) => [...line.values, ...(line.low || []), ...(line.high || [])]);
      if (view.level !== undefined && !ranges) values.push(view.level);
      if (!view.logarithmic && !ranges && Math.min(...values) > 0 && this.far(values)) values.push(0);
      const measured = axis(values, view.logarithmic);
      if (ranges) {
        this.x = measured;
        this.drawRanges(lines);
      } else {
        this.y = measured;
        this.x = axis(this.data.places[view.places], this.data.logarithmic);
        this.drawLines(lines);
      }
      this.explain();
      this.index = null;
      this.read(null);
    }

    // Whether values differ so much that their axis may begin at 0.
    far(values) {
      const known = values.filter((value) => value !== null);
      return Math.min(...known) < 0.6 * Math.max(...known);
    }

    across(value) {
      return this.size.left + this.x.at(value) * (this.size.width - this.size.left - this.size.right);
    }

    up(value) {
      const { height, top, bottom } = this.size;
      return height - bottom - this.y.at(value) * (height - top - bottom);
    }

    frame(label) {
      const { width, height, right, top, bottom } = this.size;
      for (const [value, text] of this.x.ticks) {
        const x = this.across(value);
        add(this.canvas, "line", { x1: x, x2: x, y1: top, y2: height - bottom, stroke: GRID });
        add(this.canvas, "text", { x, y: height - bottom + 15, "text-anchor": "middle" }, text);
      }
      add(this.canvas, "text", { x: width - right, y: height - 6, "text-anchor": "end" }, label);
    }

    drawLines(lines) {
      const { width, height, left, right, top, bottom } = this.size, view = this.view;
      this.frame(this.data.label);
      for (const [value, text] of this.y.ticks) {
        const y = this.up(value);
        add(this.canvas, "line", { x1: left, x2: width - right, y1: y, y2: y, stroke: GRID });
        add(this.canvas, "text", { x: left - 6, y: y + 4, "text-anchor": "end" }, text);
      }
      add(this.canvas, "text", { x: 2, y: 12, class: "label" }, view.label);
      if (view.level !== undefined) {
        const y = this.up(view.level);
        add(this.canvas, "line", { x1: left, x2: width - right, y1: y, y2: y, stroke: INK, "stroke-width": 0.7 });
      }
      const places = this.data.places[view.places];
      const kept = (value) => value !== null && (!view.logarithmic || value > 0);
      const at = (value, index) => `${this.across(places[index]).toFixed(1)} ${this.up(value).toFixed(1)}`;
      for (const line of [...lines].reverse()) {
        if (line.low) {
          const upper = line.high.map((value, i) => (kept(value) ? at(value, i) : null)).filter(Boolean);
          const lower = line.low.map((value, i) => (value === null ? null : at(value, i))).filter(Boolean).reverse();
          if (upper.length) {
            const path = `M${[...upper, ...lower].join("L")}Z`;
            add(this.canvas, "path", { d: path, fill: line.colour, "fill-opacity": 0.15, class: "band" });
          }
        }
        if (line.style === "points") {
          line.values.forEach((value, i) => {
            const place = { cx: this.across(places[i]), cy: kept(value) && this.up(value), r: 2.2, fill: line.colour };
            if (kept(value)) add(this.canvas, "circle", place);
          });
          continue;
        }
        const points = line.values.map((value, i) => (kept(value) ? at(value, i) : null)).filter(Boolean);
        if (!points.length) continue;
        if (line.style === "area") {
          const floor = height - bottom, ends = [points.at(-1), points[0]].map((each) => each.split(" ")[0]);
          const path = `M${points.join("L")}L${ends[0]} ${floor}L${ends[1]} ${floor}Z`;
          add(this.canvas, "path", { d: path, fill: line.colour, "fill-opacity": 0.12, class: "band" });
          continue;
        }
        const path = `M${points.join("L")}`;
        const style = { d: path, fill: "none", stroke: line.colour, "stroke-width": WIDTHS[line.style], class: "line" };
        if (line.style === "dashed") style["stroke-dasharray"] = "6 4";
        add(this.canvas, "path", style);
      }
      this.mark = add(this.canvas, "g", {});
      add(this.canvas, "rect", { x: left, y: top, width: width - left - right, height: height - top - bottom,
        fill: "transparent" });
    }

    drawRanges(lines) {
      const { left, top } = this.size;
      this.frame(this.view.label);
      lines.forEach((line, index) => {
        const y = top + 11 + 22 * index;
        const name = add(this.canvas, "text", { x: left - 8, y: y + 4, "text-anchor": "end" }, line.name);
        if (name.getComputedTextLength && name.getComputedTextLength() > left - 10) {
          name.setAttribute("textLength", left - 10);
          name.setAttribute("lengthAdjust", "spacingAndGlyphs");
        }
        if (line.low) {
          const [x1, x2] = [line.low[0], line.high[0]].map((value) => this.across(value));
          add(this.canvas, "line", { x1, x2, y1: y, y2: y, stroke: line.colour, "stroke-width": 3, opacity: 0.4 });
        }
        line.values.forEach((value) => {
          if (value === null) return;
          add(this.canvas, "circle", { cx: this.across(value), cy: y, r: 4.5, fill: line.colour });
        });
      });
      this.mark = add(this.canvas, "g", {});
    }

    explain() {
      if (this.data.form === "ranges") return; // its rows are named
      const open = this.more && this.more.open;
      this.legend.replaceChildren();
      const first = this.view.lines.filter((line) => line.shown), others = this.view.lines.filter((line) => !line.shown);
      for (const line of first) this.offer(line, this.legend);
      this.more = null;
      if (!others.length) return;
      this.more = add(this.legend, "details", { class: "more" });
      this.more.open = open || others.some((line) => this.shown[line.name]);
      add(this.more, "summary", {}, `${others.length} more`);
      for (const line of others) this.offer(line, this.more);
    }

    offer(line, parent) {
      const button = add(parent, "button", { type: "button", "aria-pressed": this.shown[line.name] });
      add(button, "span", { class: `swatch ${line.style}`, style: `--colour:${line.colour}` });
      button.append(line.name);
      button.addEventListener("click", () => {
        this.shown[line.name] = !this.shown[line.name];
        this.draw();
        [...this.legend.querySelectorAll("button")].find((each) => each.textContent === line.name).focus();
      });
    }

    point(event) {
      const box = this.canvas.getBoundingClientRect(), { width, height } = this.size;
      const x = ((event.clientX - box.left) / box.width) * width;
      const y = ((event.clientY - box.top) / box.height) * height;
      if (this.data.form === "ranges") {
        const row = Math.floor((y - this.size.top) / 22);
        this.read(row >= 0 && row < this.lines.length ? row : null);
        return;
      }
      const away = this.data.places[this.view.places].map((place) => Math.abs(this.across(place) - x));
      this.read(away.indexOf(Math.min(...away)));
    }

    step(event) {
      const ranges = this.data.form === "ranges";
      const many = ranges ? this.lines.length : this.data.places[this.view.places].length;
      const index = this.index === null ? -1 : this.index, jump = event.shiftKey ? 10 : 1;
      const moves = {
        ArrowRight: index + jump, ArrowDown: index + 1, ArrowLeft: index - jump, ArrowUp: index - 1, Home: 0,
        End: many - 1, Escape: null,
      };
      if (!(event.key in moves)) return;
      event.preventDefault();
      const wanted = moves[event.key];
      this.read(wanted === null ? null : Math.max(0, Math.min(many - 1, wanted)));
    }

    read(index) {
      this.index = index;
      this.mark.replaceChildren();
      if (index === null) {
        this.readout.textContent = "";
        return;
      }
      const range = (line, place) => {
        const ends = line.low ? ` (${words(line.low[place])} to ${words(line.high[place])})` : "";
        const values = this.data.form === "ranges" ? line.values : [line.values[place]];
        return `${line.name} ${values.map(words).join(", ")}${ends}`;
      };
      if (this.data.form === "ranges") {
        this.readout.textContent = range(this.lines[index], 0);
        return;
      }
      const place = this.data.places[this.view.places][index], x = this.across(place);
      const { height, top, bottom } = this.size;
      add(this.mark, "line", { x1: x, x2: x, y1: top, y2: height - bottom, stroke: FAINT });
      for (const line of this.lines) {
        const value = line.values[index];
        if (value === null || (this.view.logarithmic && value <= 0)) continue;
        add(this.mark, "circle", { cx: x, cy: this.up(value), r: 3.5, fill: line.colour, stroke: "#ffffff" });
      }
      const parts = this.lines.filter((line) => line.values[index] !== null).map((line) => range(line, index));
      this.readout.textContent = `${this.data.label}: ${words(place)} — ${parts.join("; ")}`;
    }
  }

  const charts = [...document.querySelectorAll("figure.drawn")].map((figure) => new Chart(figure));
  const redraw = () => charts.forEach((chart) => chart.box.clientWidth && chart.draw());
  let waiting;
  window.addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(redraw, 120);
  });
  document.addEventListener("toggle", (event) => {
    for (const chart of charts) if (event.target.contains(chart.box)) chart.draw();
  }, true);

  // What an address leads to is opened, and all on paper.
  function open() {
    const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let each = target; each; each = each.parentElement) if (each.tagName === "DETAILS") each.open = true;
    const own = target.querySelector(":scope > details");
    if (own) own.open = true;
    target.scrollIntoView();
  }
  window.addEventListener("hashchange", open);
  document.addEventListener("click", (event) => {
    const link = event.target.closest('a[href^="#"]');
    if (link && link.hash === location.hash) open();
  });
  let closed = [];
  window.addEventListener("beforeprint", () => {
    closed = [...document.querySelectorAll("details:not([open], .more, .values)")];
    for (const each of closed) each.open = true;
  });
  window.addEventListener("afterprint", () => {
    for (const each of closed) each.open = false;
  });
  open();
})();
