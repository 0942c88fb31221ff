// A scatter plot of all episodes. A brush in it chooses episodes, and the chosen episode is marked in it.

const MARGIN = {left: 44, right: 8, top: 8, bottom: 22};  // px
const NEAR = 8;  // px, distance of a click from a point

export class Plot {
  /** `kind(episode)` returns keep, drop or undecided; `brushed(range)` and `clicked(episode)` are called. */
  constructor(canvas, {kind, brushed, clicked}) {
    Object.assign(this, {canvas, kind, brushed, clicked, points: [], shown: new Set(), range: null});
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  setData(rows, x, y) {
    this.points = rows.filter((row) => row[x] != null && row[y] != null)
      .map((row) => ({episode: row.episode, x: Number(row[x]), y: Number(row[y])}));
    const bounds = (axis) => {
      let low = Infinity, high = -Infinity;
      for (const point of this.points) { low = Math.min(low, point[axis]); high = Math.max(high, point[axis]); }
      if (low > high) [low, high] = [0, 1];
      const pad = (high - low) * 0.04 || 0.5;
      return [low - pad, high + pad];
    };
    this.bounds = {x: bounds("x"), y: bounds("y")};
    this.draw();
  }

  toPixel(axis, value) {
    const [low, high] = this.bounds[axis], share = (value - low) / (high - low);
    return axis === "x" ? MARGIN.left + share * this.inner.width : MARGIN.top + (1 - share) * this.inner.height;
  }

  toValue(axis, pixel) {
    const [low, high] = this.bounds[axis];
    const share = axis === "x" ? (pixel - MARGIN.left) / this.inner.width : 1 - (pixel - MARGIN.top) / this.inner.height;
    return low + share * (high - low);
  }

  get inner() {
    return {
      width: this.canvas.clientWidth - MARGIN.left - MARGIN.right,
      height: this.canvas.clientHeight - MARGIN.top - MARGIN.bottom,
    };
  }

  draw() {
    cancelAnimationFrame(this.pending);
    this.pending = requestAnimationFrame(() => this.paint());
  }

  paint() {
    const canvas = this.canvas, scale = devicePixelRatio, style = getComputedStyle(canvas);
    if (!canvas.clientWidth || !this.bounds) return;
    canvas.width = canvas.clientWidth * scale;
    canvas.height = canvas.clientHeight * scale;
    const pen = canvas.getContext("2d"), colour = (name) => style.getPropertyValue(name);
    pen.scale(scale, scale);
    this.paintAxes(pen, colour);
    const colours = {keep: colour("--fine"), drop: colour("--bad"), undecided: colour("--good")};
    for (const visible of [false, true]) {
      pen.globalAlpha = visible ? 0.8 : 0.15;
      for (const point of this.points) {
        if (this.shown.has(point.episode) !== visible) continue;
        pen.fillStyle = colours[this.kind(point.episode)];
        pen.fillRect(this.toPixel("x", point.x) - 1.5, this.toPixel("y", point.y) - 1.5, 3, 3);
      }
    }
    pen.globalAlpha = 1;
    const marked = this.points.find((point) => point.episode === this.marked);
    pen.strokeStyle = colour("--ink");
    if (marked) pen.strokeRect(this.toPixel("x", marked.x) - 5, this.toPixel("y", marked.y) - 5, 10, 10);
    const range = this.drawn ?? this.range;
    if (!range) return;
    pen.setLineDash([4, 3]);
    const [left, top] = [this.toPixel("x", range.x[0]), this.toPixel("y", range.y[1])];
    pen.strokeRect(left, top, this.toPixel("x", range.x[1]) - left, this.toPixel("y", range.y[0]) - top);
  }

  paintAxes(pen, colour) {
    pen.font = "11px system-ui, sans-serif";
    for (const axis of ["x", "y"]) {
      const [low, high] = this.bounds[axis], step = niceStep((high - low) / 4);
      for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
        const at = this.toPixel(axis, value), text = String(Number(value.toPrecision(4)));
        pen.strokeStyle = colour("--line");
        pen.fillStyle = colour("--muted");
        pen.beginPath();
        if (axis === "x") { pen.moveTo(at, MARGIN.top); pen.lineTo(at, MARGIN.top + this.inner.height); }
        else { pen.moveTo(MARGIN.left, at); pen.lineTo(MARGIN.left + this.inner.width, at); }
        pen.stroke();
        pen.textAlign = axis === "x" ? "center" : "right";
        if (axis === "x") pen.fillText(text, at, this.canvas.clientHeight - 7);
        else pen.fillText(text, MARGIN.left - 5, at + 4);
      }
    }
  }

  rangeTo(event) {
    const [x, y] = [[this.start.offsetX, event.offsetX], [this.start.offsetY, event.offsetY]];
    const sorted = (axis, pixels) => pixels.map((pixel) => this.toValue(axis, pixel)).sort((a, b) => a - b);
    return {x: sorted("x", x), y: sorted("y", y)};
  }

  down(event) {
    if (!this.bounds) return;
    this.start = event;
    this.canvas.setPointerCapture(event.pointerId);
  }

  drag(event) {
    if (!this.start) return;
    this.drawn = this.rangeTo(event);
    this.draw();
  }

  up(event) {
    if (!this.start) return;
    const moved = Math.hypot(event.offsetX - this.start.offsetX, event.offsetY - this.start.offsetY);
    const range = this.rangeTo(event);
    this.start = this.drawn = null;
    if (moved > 4) this.brushed(range);
    else this.click(event);
    this.draw();
  }

  click(event) {
    let best = null, least = NEAR;
    for (const point of this.points) {
      if (!this.shown.has(point.episode)) continue;
      const away = Math.hypot(this.toPixel("x", point.x) - event.offsetX, this.toPixel("y", point.y) - event.offsetY);
      if (away < least) [best, least] = [point, away];
    }
    if (best) this.clicked(best.episode);
  }
}

/** The step 1, 2 or 5 times a power of ten that is next to `step`. */
export function niceStep(step) {
  const power = 10 ** Math.floor(Math.log10(step));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= step * 0.999);
}
