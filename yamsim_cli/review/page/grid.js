// The overview: only the visible cells of the grid exist, and their film strips load once scrolling pauses.

const CELL = {width: 300, height: 112};  // px, smallest width and the height of a cell
const PAUSE_MS = 60;  // of scrolling, after which film strips load
const EXTRA_ROWS = 2;  // above and below the visible ones

export class Grid {
  /** `describe(episode)` returns {title, facts, label, kind}; `strip(episode)` the address of a film strip. */
  constructor(viewport, spacer, {describe, strip, chosen, opened}) {
    Object.assign(this, {viewport, spacer, describe, strip, chosen, opened});
    this.order = [];
    this.cursor = 0;
    this.pool = new Map();
    this.free = [];
    viewport.addEventListener("scroll", () => this.schedule(), {passive: true});
    new ResizeObserver(() => this.layout()).observe(viewport);
    viewport.addEventListener("keydown", (event) => this.onKey(event));
  }

  show(order, episode) {
    this.order = order;
    this.cursor = Math.max(0, order.indexOf(episode));
    this.layout();
    this.reveal();
  }

  get current() { return this.order[this.cursor]; }

  layout() {
    if (!this.viewport.clientWidth) return;
    this.columns = Math.max(1, Math.floor(this.viewport.clientWidth / CELL.width));
    this.width = Math.floor(this.viewport.clientWidth / this.columns);
    this.spacer.style.height = `${Math.ceil(this.order.length / this.columns) * CELL.height}px`;
    this.refresh();
  }

  /** Fill all cells again, after decisions or the order have changed. */
  refresh() {
    for (const cell of this.pool.values()) this.free.push(cell);
    this.pool.clear();
    this.render();
  }

  schedule() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => { this.pending = 0; this.render(); });
  }

  render() {
    if (!this.columns) return;
    const top = this.viewport.scrollTop, height = this.viewport.clientHeight;
    const first = Math.max(0, Math.floor(top / CELL.height) - EXTRA_ROWS) * this.columns;
    const last = Math.min(this.order.length, (Math.ceil((top + height) / CELL.height) + EXTRA_ROWS) * this.columns);
    for (const [index, cell] of this.pool) {
      if (index < first || index >= last) { this.pool.delete(index); this.free.push(cell); }
    }
    for (let index = first; index < last; index++) if (!this.pool.has(index)) this.fill(index);
    for (const cell of this.free.splice(0)) cell.remove();
    clearTimeout(this.loading);
    this.loading = setTimeout(() => this.loadStrips(), PAUSE_MS);
  }

  fill(index) {
    const cell = this.free.pop() ?? this.make();
    const episode = this.order[index], {title, facts, label, kind} = this.describe(episode);
    cell.className = `cell ${kind}`;
    cell.id = `cell-${episode}`;
    cell.episode = episode;
    cell.style.transform =
      `translate(${(index % this.columns) * this.width}px, ${Math.floor(index / this.columns) * CELL.height}px)`;
    cell.style.width = `${this.width - 8}px`;
    cell.style.height = `${CELL.height - 6}px`;
    cell.ariaLabel = label;
    cell.ariaPosInSet = index + 1;
    cell.ariaSetSize = this.order.length;
    cell.ariaSelected = index === this.cursor;
    cell.badge.textContent = kind === "undecided" ? "" : kind;
    cell.name.data = ` ${title}`;
    cell.facts.textContent = facts;
    if (cell.image.dataset.episode !== String(episode)) {
      cell.image.removeAttribute("src");
      cell.image.dataset.episode = episode;
    }
    if (!cell.isConnected) this.spacer.append(cell);
    this.pool.set(index, cell);
    if (index === this.cursor) this.viewport.setAttribute("aria-activedescendant", cell.id);
  }

  make() {
    const cell = document.createElement("div");
    cell.role = "option";
    cell.image = document.createElement("img");
    cell.image.alt = "";
    cell.image.decoding = "async";
    const line = document.createElement("p");
    cell.badge = document.createElement("b");
    cell.name = document.createTextNode("");
    line.append(cell.badge, cell.name);
    cell.facts = document.createElement("p");
    cell.facts.className = "facts";
    cell.append(cell.image, line, cell.facts);
    cell.addEventListener("click", () => this.move(this.order.indexOf(cell.episode)));
    cell.addEventListener("dblclick", () => this.opened(cell.episode));
    return cell;
  }

  loadStrips() {
    for (const cell of this.pool.values()) {
      if (!cell.image.hasAttribute("src")) cell.image.src = this.strip(cell.episode);
    }
  }

  move(index) {
    if (!this.order.length) return;
    const before = this.pool.get(this.cursor);
    if (before) before.ariaSelected = false;
    this.cursor = Math.min(Math.max(index, 0), this.order.length - 1);
    this.reveal();
    this.chosen(this.current);
  }

  reveal() {
    const top = Math.floor(this.cursor / this.columns) * CELL.height, view = this.viewport;
    if (top < view.scrollTop) view.scrollTop = top;
    else if (top + CELL.height > view.scrollTop + view.clientHeight) view.scrollTop = top + CELL.height - view.clientHeight;
    this.render();
    const cell = this.pool.get(this.cursor);
    if (!cell) return;
    cell.ariaSelected = true;
    view.setAttribute("aria-activedescendant", cell.id);
  }

  onKey(event) {
    const page = Math.max(1, Math.floor(this.viewport.clientHeight / CELL.height)) * this.columns;
    const steps = {ArrowLeft: -1, ArrowRight: 1, ArrowUp: -this.columns, ArrowDown: this.columns, PageUp: -page, PageDown: page};
    if (event.key in steps) this.move(this.cursor + steps[event.key]);
    else if (event.key === "Home") this.move(0);
    else if (event.key === "End") this.move(this.order.length - 1);
    else if (event.key === "Enter" && this.order.length) this.opened(this.current);
    else return;
    event.preventDefault();
  }
}
