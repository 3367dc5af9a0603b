// Two pictures on top of each other with a slider between them: truth, predictions, error maps.
(() => {
  const galleries = page.data.pictures;
  if (!galleries.length) return;
  const [boardSelect, viewSelect, kindSelect, leftSelect, rightSelect] =
    ["board", "view", "kind", "left", "right"].map((name) => document.getElementById(`picture-${name}`));
  const frame = document.getElementById("compare"), table = document.getElementById("picture-scores");
  let kind, layers;

  /** What can be shown: [name, picture, what to say where there is none]. */
  function layersOf(kind) {
    return [
      { name: "truth", picture: kind.truth, reason: kind.reason },
      ...kind.runs.map((run) => ({ name: run.name, picture: run.picture, reason: run.reason })),
      ...kind.runs.filter((run) => run.error).map((run) => ({ name: `error of ${run.name}`, picture: run.error, reason: "" })),
      ...kind.runs.filter((run) => run.resolved).map((run) => ({ name: `resolved, ${run.name}`, picture: run.resolved, reason: "" })),
    ];
  }

  function chooseBoard() {
    const views = galleries[boardSelect.selectedIndex].views;
    page.choices(viewSelect, views.map((view) => view.name + (view.lens ? ` (${view.lens})` : "")));
    chooseView();
  }

  function chooseView() {
    const view = galleries[boardSelect.selectedIndex].views[viewSelect.selectedIndex];
    page.choices(kindSelect, Object.values(view.kinds).map((one) => one.title));
    chooseKind();
  }

  function chooseKind() {
    const view = galleries[boardSelect.selectedIndex].views[viewSelect.selectedIndex];
    kind = Object.values(view.kinds)[kindSelect.selectedIndex];
    layers = layersOf(kind);
    const first = leftSelect.options.length === 0, names = layers.map((layer) => layer.name);
    const kept = rightSelect.selectedOptions[0]?.textContent;
    page.choices(leftSelect, names);
    page.choices(rightSelect, names);
    // Without the truth two pictures of a method, else truth against the first method.
    if (first || !names.includes(kept)) {
      const there = names.map((_, index) => index).filter((index) => layers[index].picture);
      leftSelect.selectedIndex = there[0] ?? 0;
      rightSelect.selectedIndex = there[1] ?? there[0] ?? 0;
    }
    show();
    const scores = kind.runs.filter((run) => run.scores.length);
    const headings = [...new Set(scores.flatMap((run) => run.scores.map(([label]) => label)))];
    table.replaceChildren(
      page.make("thead", {}, page.make("tr", {}, ...["this view", ...headings].map((text, k) =>
        page.make("th", { scope: "col", class: k ? "number plain" : "plain" }, text)))),
      page.make("tbody", {}, ...scores.map((run) => page.make("tr", {}, page.make("th", { scope: "row" }, run.name),
        ...headings.map((label) => page.make("td", { class: "number" }, Object.fromEntries(run.scores)[label] ?? "not scored"))))));
  }

  function show() {
    const sides = [["left", layers[leftSelect.selectedIndex]], ["right", layers[rightSelect.selectedIndex]]];
    const missing = sides.filter(([, layer]) => !layer.picture);
    const note = document.getElementById("picture-missing");
    note.hidden = !missing.length;
    note.textContent = missing.map(([, layer]) => `No picture of ${layer.name}: ${layer.reason}.`).join(" ");
    frame.hidden = missing.length > 0;
    if (missing.length) return;
    for (const [side, layer] of sides) {
      const image = frame.querySelector(`img.${side}`);
      image.src = layer.picture;
      image.alt = `${layer.name}, ${kind.title}`;
      // As high as the window at most: one must see all of both at once.
      image.decode().then(() => frame.style.setProperty("--aspect", image.naturalWidth / image.naturalHeight), () => {});
      frame.querySelector(`.tag.${side} span`).textContent = layer.name;
    }
    for (const [id, layers] of [["picture-scale", "error of"], ["picture-resolved", "resolved, "]])
      document.getElementById(id).hidden = !sides.some(([, layer]) => layer.name.startsWith(layers));
  }

  const slider = frame.querySelector("input");
  slider.addEventListener("input", () => {
    frame.style.setProperty("--split", `${slider.value}%`);
    slider.setAttribute("aria-valuetext", `${slider.value} % from the left`);
  });
  page.choices(boardSelect, galleries.map((gallery) => gallery.board));
  boardSelect.addEventListener("change", chooseBoard);
  viewSelect.addEventListener("change", chooseView);
  kindSelect.addEventListener("change", chooseKind);
  leftSelect.addEventListener("change", show);
  rightSelect.addEventListener("change", show);
  chooseBoard();
})();
