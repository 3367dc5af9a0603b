// Pictures of one view next to each other under one zoom, or two of them under a slider; refocus frames.
(() => {
  const root = document.getElementById("pictures");
  if (!root) return;
  const [boardSelect, viewSelect, kindSelect, leftSelect, rightSelect] =
    ["board", "view", "kind", "left", "right"].map((name) => document.getElementById(`picture-${name}`));
  const compare = document.getElementById("compare"), wiped = document.getElementById("wiped"), wipe = document.getElementById("wipe");
  const inside = (node, selector) => [...node.querySelectorAll(selector)];
  const boards = inside(root, ".board"), moving = inside(root, ".moving");
  const ZOOMS = [0, 1, 2, 3, 4, 6, 8, 12, 16];   // pixels of the screen for one of the picture; 0 fits
  let kind, layers = [];
  const zoom = { at: 0, x: 0, y: 0 };   // x, y: the middle of the crop in pixels of the picture

  // ---- what is shown ----

  const shown = (nodes, select) => nodes[select.selectedIndex];
  const titles = (nodes) => nodes.map((node) => node.dataset.title);

  function chooseBoard() {
    for (const nodes of [boards, moving]) nodes.forEach((node) => node.classList.toggle("shown", node === shown(nodes, boardSelect)));
    page.choices(viewSelect, titles(inside(shown(boards, boardSelect), ".view")));
    chooseView();
  }

  function chooseView() {
    const view = shown(inside(shown(boards, boardSelect), ".view"), viewSelect);
    view.open = true;
    page.choices(kindSelect, titles(inside(view, ".kind")));
    chooseKind();
  }

  function chooseKind() {
    const kinds = inside(shown(inside(shown(boards, boardSelect), ".view"), viewSelect), ".kind");
    kind?.classList.remove("shown");
    kind = shown(kinds, kindSelect);
    kind.classList.add("shown");
    for (const image of inside(kind, "img")) image.loading = "eager";   // so that a key shows them at once
    for (const id of ["error", "resolved"]) {
      const radio = document.getElementById(`layer-${id}`);
      radio.disabled = !kind.querySelector(`img.${id}`);
      if (radio.disabled && radio.checked) document.getElementById("layer-picture").checked = true;
    }
    const before = [leftSelect, rightSelect].map((select) => select.selectedOptions[0]?.textContent);
    layers = inside(kind, ".pane img").map((image) => ({ image, name: nameOf(image) }));
    const names = layers.map(({ name }) => name), pictures = layers.filter(({ image }) => image.className === "picture");
    page.choices(leftSelect, names);
    page.choices(rightSelect, names);
    if (!names.includes(before[1])) {
      leftSelect.selectedIndex = layers.indexOf(pictures[0]);
      rightSelect.selectedIndex = layers.indexOf(pictures[1] ?? pictures[0]);
    }
    showWipe();
    apply();
  }

  function nameOf(image) {
    const name = image.closest("figure").dataset.name;
    return { picture: name, error: `error of ${name}`, resolved: `resolved, ${name}` }[image.className];
  }

  function showLayer(id) {
    const radio = document.getElementById(`layer-${id}`);
    if (radio.disabled) return;
    (radio.checked ? document.getElementById("layer-picture") : radio).checked = true;
    page.say(radio.checked ? radio.labels[0].textContent : "Pictures");
  }

  // ---- two under a slider ----

  function setWipe(on) {
    wipe.setAttribute("aria-pressed", on);
    wiped.hidden = !on;
    root.classList.toggle("wiping", on);
    apply();
  }

  function showWipe() {
    if (!layers.length) return;
    for (const [side, select] of [["left", leftSelect], ["right", rightSelect]]) {
      const { image, name } = layers[select.selectedIndex], target = compare.querySelector(`img.${side}`);
      target.src = image.src;
      target.alt = image.alt;
      compare.querySelector(`.tag.${side} span`).textContent = name;
    }
    compare.style.cssText = kind.querySelector(".places").style.cssText + `--split: ${slider.value}%`;
    apply();
  }

  const slider = compare.querySelector("input");
  slider.addEventListener("input", () => {
    compare.style.setProperty("--split", `${slider.value}%`);
    slider.setAttribute("aria-valuetext", `${slider.value} % from the left`);
  });

  // ---- one zoom for all ----

  const places = () => (wiped.hidden ? kind.querySelector(".places") : compare);
  const size = () => ["--wide", "--high"].map((name) => Number(places().style.getPropertyValue(name)));

  /** The crop as lengths that every picture's style uses, at whole pixels of the screen. */
  function apply() {
    if (!kind) return;
    const area = places(), [wide, high] = size(), factor = ZOOMS[zoom.at], scale = factor / devicePixelRatio;
    document.getElementById("zoom").textContent = factor ? `${factor}×` : "fit";
    area.classList.toggle("zoomed", factor > 0);
    if (!factor) return;
    const pane = area.querySelector(".pane");
    const start = (room, length, centre) => {
      const from = length <= room ? (room - length) / 2 : Math.min(0, Math.max(room - length, room / 2 - centre * scale));
      return Math.round(from * devicePixelRatio) / devicePixelRatio;
    };
    const [left, top] = [start(pane.clientWidth, wide * scale, zoom.x), start(pane.clientHeight, high * scale, zoom.y)];
    if (wide * scale > pane.clientWidth) zoom.x = (pane.clientWidth / 2 - left) / scale;
    if (high * scale > pane.clientHeight) zoom.y = (pane.clientHeight / 2 - top) / scale;
    for (const [name, value] of [["--left", left], ["--top", top], ["--width", wide * scale]]) area.style.setProperty(name, `${value}px`);
  }

  /** Zoom by `steps`, keeping the point of the picture under the pointer; without one the middle. */
  function step(steps, event) {
    const at = Math.max(0, Math.min(ZOOMS.length - 1, zoom.at + steps));
    if (at === zoom.at) return;
    const [wide, high] = size();
    const pane = event?.target.closest(".pane, .compare") ?? places().querySelector(".pane"), box = pane.getBoundingClientRect();
    const [px, py] = event ? [event.clientX - box.left, event.clientY - box.top] : [box.width / 2, box.height / 2];
    const before = ZOOMS[zoom.at] / devicePixelRatio, after = ZOOMS[at] / devicePixelRatio;
    const point = before ? [zoom.x + (px - box.width / 2) / before, zoom.y + (py - box.height / 2) / before]
      : [(px / box.width) * wide, (py / box.height) * high];
    zoom.at = at;
    if (after) [zoom.x, zoom.y] = [point[0] - (px - box.width / 2) / after, point[1] - (py - box.height / 2) / after];
    apply();
    page.say(`Zoom ${document.getElementById("zoom").textContent}`);
  }

  function move(dx, dy) {
    const scale = ZOOMS[zoom.at] / devicePixelRatio;
    if (!scale) return false;
    zoom.x += dx / scale;
    zoom.y += dy / scale;
    apply();
    return true;
  }

  let turned = 0;
  root.addEventListener("wheel", (event) => {
    const area = event.target.closest(".kind .places, .compare");
    // Over a picture that wasn't clicked, the wheel scrolls the page.
    if (!area || !(event.ctrlKey || area.contains(document.activeElement))) return;
    event.preventDefault();
    turned += event.deltaY;
    if (Math.abs(turned) < 40) return;
    step(turned < 0 ? 1 : -1, event);
    turned = 0;
  }, { passive: false });

  root.addEventListener("pointerdown", (event) => {
    const pane = event.target.closest(".kind .pane");
    if (!pane || event.button) return;
    event.preventDefault();
    pane.closest(".places").focus({ preventScroll: true });
    if (!zoom.at) return;
    pane.setPointerCapture(event.pointerId);
    let [x, y] = [event.clientX, event.clientY];
    const drag = (to) => {
      move(x - to.clientX, y - to.clientY);
      [x, y] = [to.clientX, to.clientY];
    };
    pane.addEventListener("pointermove", drag);
    pane.addEventListener("lostpointercapture", () => pane.removeEventListener("pointermove", drag), { once: true });
  });
  root.addEventListener("dblclick", (event) => {
    if (event.target.closest(".kind .pane")) step(zoom.at ? -zoom.at : 4, event);
  });

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, textarea, input[type=text]")) return;
    const key = event.key.toLowerCase();
    if (key === "e") return showLayer("error");
    if (key === "r") return showLayer("resolved");
    if (key === "w") return setWipe(wiped.hidden);
    if (!event.target.closest(".kind .places, .compare")) return;
    const way = { arrowleft: [-40, 0], arrowright: [40, 0], arrowup: [0, -40], arrowdown: [0, 40] }[key];
    if (way && event.target !== slider) { if (move(...way)) event.preventDefault(); }
    else if (key === "+" || key === "=") step(1);
    else if (key === "-") step(-1);
    else if (key === "0") step(-zoom.at);
  });
  document.getElementById("zoom-in").addEventListener("click", () => step(1));
  document.getElementById("zoom-out").addEventListener("click", () => step(-1));
  wipe.addEventListener("click", () => setWipe(wiped.hidden));
  new ResizeObserver(apply).observe(root);

  // ---- refocus frames ----

  for (const part of inside(root, ".refocus")) {
    const range = part.querySelector("input"), stacks = inside(part, ".pane").map((pane) => inside(pane, "img"));
    const load = () => { for (const frame of stacks.flat()) frame.loading = "eager"; };
    range.addEventListener("pointerenter", load, { once: true });
    range.addEventListener("focus", load, { once: true });
    range.addEventListener("input", () => {
      for (const stack of stacks) stack.forEach((frame, k) => frame.classList.toggle("now", k === Number(range.value)));
    });
  }

  page.choices(boardSelect, titles(boards));
  boardSelect.parentElement.hidden = boards.length < 2;
  boardSelect.addEventListener("change", chooseBoard);
  viewSelect.addEventListener("change", chooseView);
  kindSelect.addEventListener("change", chooseKind);
  leftSelect.addEventListener("change", showWipe);
  rightSelect.addEventListener("change", showWipe);
  zoom.x = zoom.y = 0;
  chooseBoard();
})();
