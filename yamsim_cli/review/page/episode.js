// One episode: all cameras in step with joints, commands, grippers and events on one time line.

import {get} from "/server.js";

const AHEAD = 12;  // frames that are fetched before they are shown
const KEPT = 60;  // frames whose pictures stay in memory
const GRIPPER_SHARE = 0.25;  // of the time line's height

/** The cameras of one episode, each on a canvas. */
class Cameras {
  constructor(box, address) {
    Object.assign(this, {box, address, pictures: new Map(), canvases: []});
  }

  clear() {
    this.detail = null;
    this.pictures.clear();
    this.box.replaceChildren();
    this.canvases = [];
  }

  open(detail) {
    this.clear();
    this.detail = detail;
    this.canvases = detail.cameras.map((camera) => {
      const canvas = document.createElement("canvas"), caption = document.createElement("figcaption");
      [canvas.width, canvas.height] = detail.sizes[camera];
      canvas.role = "img";
      canvas.ariaLabel = `Camera ${camera}`;
      caption.textContent = camera;
      const figure = document.createElement("figure");
      figure.append(canvas, caption);
      this.box.append(figure);
      return canvas;
    });
  }

  /** Return a promise of the pictures of all cameras; null for one that cannot be read. */
  load(frame) {
    let found = this.pictures.get(frame);
    if (!found) {
      found = Promise.all(this.detail.cameras.map(async (camera) => {
        try {
          const answer = await fetch(this.address(this.detail.episode, camera, frame));
          if (answer.ok) return await createImageBitmap(await answer.blob());
          return (await answer.json()).error;
        } catch {
          return "the picture cannot be read";
        }
      }));
      this.pictures.set(frame, found);
      if (this.pictures.size > KEPT) this.pictures.delete(this.pictures.keys().next().value);
    }
    return found;
  }

  /** Draw the pictures of all cameras at once, and return what could not be read. */
  async draw(frame, isWanted) {
    const {detail} = this;
    const pictures = await this.load(frame);
    if (!isWanted() || detail !== this.detail) return "";
    let fault = "";
    pictures.forEach((picture, k) => {
      const pen = this.canvases[k]?.getContext("2d");
      if (!pen) return;
      pen.clearRect(0, 0, pen.canvas.width, pen.canvas.height);
      if (typeof picture === "string") fault ||= picture;
      else pen.drawImage(picture, 0, 0, pen.canvas.width, pen.canvas.height);
    });
    for (let k = 1; k <= AHEAD && frame + k < detail.frames; k++) this.load(frame + k);
    return fault;
  }
}

export class EpisodeView {
  /** `address(episode, camera, frame)` is that of a picture; `failed(text)` tells a fault. */
  constructor(address, {failed}) {
    this.failed = failed;
    this.find = (id) => document.getElementById(id);
    this.cameras = new Cameras(this.find("cameras"), address);
    this.pinned = new Cameras(this.find("pinned"), address);
    this.slider = this.find("frame");
    this.canvas = this.find("timeline");
    this.slider.addEventListener("input", () => { this.pause(); this.seek(Number(this.slider.value)); });
    this.find("play").addEventListener("click", () => this.toggle());
    const scrub = (event) => { if (event.buttons && this.detail) { this.pause(); this.seek(this.frameAt(event.offsetX)); } };
    this.canvas.addEventListener("pointerdown", scrub);
    this.canvas.addEventListener("pointermove", scrub);
    new ResizeObserver(() => this.paint()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
  }

  async open(episode) {
    this.pause();
    this.detail = null;
    this.wanted = episode;
    this.cameras.clear();
    for (const id of ["time", "facts", "legend"]) this.find(id).textContent = "";
    const detail = await get(`/api/episode/${episode}`);
    if (this.wanted !== episode) return;
    this.detail = detail;
    this.cameras.open(detail);
    this.slider.max = detail.frames - 1;
    this.describe();
    await this.seek(0);
  }

  describe() {
    const {measures, events, prompt, names, series, grippers} = this.detail;
    const number = (value) => Number(value.toPrecision(3));
    const texts = measures.map((each) => each.what + (each.margin == null ? "" : ` by ${number(each.margin)} ${each.unit}`));
    texts.push(...events.map((event) => `frame ${event.frame}: ${event.what}`));
    this.find("facts").textContent = [prompt && `“${prompt}”`, ...texts].filter(Boolean).join(" · ");
    this.find("legend").replaceChildren(...names.map((name, k) => {
      const label = document.createElement("span"), mark = document.createElement("i");
      mark.style.background = this.colour(k);
      label.append(mark, name + (grippers.includes(k) ? " (m, below)" : ""));
      return label;
    }));
    if (series.commands.length) this.find("legend").append("dashed: commands");
  }

  colour(k) { return `hsl(${(k * 47) % 360} 65% 50%)`; }

  /** Pin this episode beside the next one, or unpin it if it is pinned; return whether one is pinned. */
  pin() {
    if (!this.detail) return Boolean(this.pinned.detail);
    const isNew = this.pinned.detail !== this.detail;
    this.find("pinned-side").hidden = !isNew;
    this.pinned.detail = null;
    if (isNew) {
      this.pinned.open(this.detail);
      this.find("pinned-title").textContent = `Episode ${this.detail.episode}, ${this.detail.frames} frames; the faint lines below are its joints`;
    }
    this.seek(this.frame);
    return isNew;
  }

  async seek(frame) {
    if (!this.detail) return;
    this.frame = Math.min(Math.max(frame, 0), this.detail.frames - 1);
    this.slider.value = this.frame;
    const time = this.detail.times[this.frame] ?? 0;
    this.find("time").textContent = `frame ${this.frame} of ${this.detail.frames - 1}, ${time.toFixed(2)} s`;
    this.slider.ariaValueText = this.find("time").textContent;
    this.paint();
    const wanted = this.frame, isWanted = () => wanted === this.frame;
    const shown = [this.cameras.draw(wanted, isWanted)];
    if (this.pinned.detail) shown.push(this.pinned.draw(Math.min(wanted, this.pinned.detail.frames - 1), isWanted));
    const fault = (await Promise.all(shown)).find(Boolean);
    if (fault) this.failed(fault);
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }

  pause() {
    this.playing = null;
    this.find("play").textContent = "Play";
  }

  async play() {
    if (!this.detail) return;
    const run = this.playing = {};  // tells this run of the loop from a later one
    this.find("play").textContent = "Pause";
    if (this.frame >= this.detail.frames - 1) await this.seek(0);
    const detail = this.detail, began = performance.now(), start = this.frame;
    while (this.playing === run && this.detail === detail && this.frame < detail.frames - 1) {
      await new Promise(requestAnimationFrame);
      const due = start + Math.floor((performance.now() - began) / 1000 / detail.period_s);
      if (due > this.frame && this.playing === run) await this.seek(due);
    }
    if (this.playing === run) this.pause();
  }

  frameAt(pixel) { return Math.round((pixel / this.canvas.clientWidth) * (this.detail.frames - 1)); }

  setTrim(first, last) {
    [this.first, this.last] = [first, last];
    this.paint();
  }

  paint() {
    const {canvas, detail} = this, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!detail || !width) return;
    canvas.width = width * devicePixelRatio;
    canvas.height = height * devicePixelRatio;
    const pen = canvas.getContext("2d"), style = getComputedStyle(canvas);
    pen.scale(devicePixelRatio, devicePixelRatio);
    const across = (frame) => (frame / Math.max(1, detail.frames - 1)) * width;
    const split = detail.grippers.length ? height * (1 - GRIPPER_SHARE) : height;
    const joints = detail.names.map((_, k) => k).filter((k) => !detail.grippers.includes(k));
    this.paintSeries(pen, joints, across, 4, split - 4);
    this.paintSeries(pen, detail.grippers, across, split + 4, height - 4);
    this.canvas.ariaLabel = this.pinned.detail
      ? `Joints, commands, grippers and events over time; faint: the joints of episode ${this.pinned.detail.episode}`
      : "Joints, commands, grippers and events over time";
    pen.fillStyle = style.getPropertyValue("--muted");
    pen.globalAlpha = 0.35;
    pen.fillRect(0, 0, across(this.first ?? 0), height);
    pen.fillRect(across(this.last ?? detail.frames - 1), 0, width, height);
    pen.globalAlpha = 1;
    for (const event of detail.events) pen.fillRect(across(event.frame) - 1, 0, 2, 8);
    pen.fillStyle = style.getPropertyValue("--ink");
    pen.fillRect(across(this.frame) - 1, 0, 2, height);
  }

  paintSeries(pen, columns, across, top, bottom) {
    const {series} = this.detail, other = this.pinned.detail?.series.joints ?? [];
    let low = Infinity, high = -Infinity;
    for (const row of [...series.joints, ...series.commands, ...other]) {
      for (const k of columns) if (row[k] != null) { low = Math.min(low, row[k]); high = Math.max(high, row[k]); }
    }
    const up = (value) => bottom - ((value - low) / (high - low || 1)) * (bottom - top);
    for (const [rows, dash, share] of [[other, [], 0.35], [series.joints, [], 1], [series.commands, [4, 3], 1]]) {
      pen.setLineDash(dash);
      pen.globalAlpha = share;
      for (const k of columns) {
        pen.strokeStyle = this.colour(k);
        pen.beginPath();
        rows.forEach((row, frame) => { if (row[k] != null) pen.lineTo(across(frame), up(row[k])); });
        pen.stroke();
      }
    }
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }
}
