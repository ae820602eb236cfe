// Curves over time: dragging zooms, pointing reads off, boxes choose the curves.
for (const figure of document.querySelectorAll(".curves")) {
  const {time, lines: pairs} = JSON.parse(figure.querySelector("script").textContent);
  const lines = Object.fromEntries(pairs), names = pairs.map(pair => pair[0]);
  const svg = figure.querySelector("svg"), said = figure.querySelector(".read"), whole = figure.querySelector("button");
  const boxes = [...figure.querySelectorAll("input")], minus = boxes.pop(), hint = said.textContent;
  const left = 52, below = 22, above = 8;
  let first = 0, last = time.length - 1, start = null;
  const words = value => value === null ? "–" : Number(value.toPrecision(4)).toString().replace("-", "\u2212");
  const at = (name, i) => {
    const [value, truth] = [lines[name][i], lines[names[0]][i]];
    return !minus.checked || value === null ? value : truth === null ? null : value - truth;
  };
  const add = (tag, given, content) => {
    const one = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [key, value] of Object.entries(given)) one.setAttribute(key, value);
    if (content !== undefined) one.textContent = content;
    return svg.appendChild(one);
  };
  const size = () => [svg.clientWidth || 600, svg.clientHeight || 220];
  const index = event => {
    const x = event.clientX - svg.getBoundingClientRect().left, part = (x - left) / (size()[0] - left);
    const when = time[first] + Math.min(1, Math.max(0, part)) * (time[last] - time[first]);
    let near = first;
    for (let i = first; i <= last; i++) if (Math.abs(time[i] - when) < Math.abs(time[near] - when)) near = i;
    return near;
  };
  const place = i => left + (size()[0] - left) * (time[i] - time[first]) / (time[last] - time[first] || 1);
  const draw = () => {
    const [width, height] = size(), shown = names.filter((_, k) => boxes[k].checked);
    svg.replaceChildren();
    whole.hidden = first === 0 && last === time.length - 1;
    let low = Infinity, high = -Infinity;
    for (const name of shown) for (let i = first; i <= last; i++) {
      const value = at(name, i);
      if (value !== null) [low, high] = [Math.min(low, value), Math.max(high, value)];
    }
    if (low > high) return;
    if (low === high) [low, high] = [low - 1, high + 1];
    const row = value => above + (height - above - below) * (high - value) / (high - low);
    const nice = (a, b, least) => {  // at least so many ticks, at round values
      const most = (b - a) / least, power = 10 ** Math.floor(Math.log10(most));
      const step = power * [5, 2, 1].find(m => m * power <= most), ticks = [];
      for (let t = Math.ceil(a / step) * step; t <= b + 1e-9 * step; t += step) ticks.push(Math.abs(t) < 1e-9 * step ? 0 : t);
      return ticks;
    };
    for (const tick of nice(low, high, 3)) {
      add("path", {class: "axis", d: `M${left} ${row(tick)}H${width}`});
      add("text", {x: left - 5, y: row(tick) + 4, "text-anchor": "end"}, words(tick));
    }
    for (const tick of nice(time[first], time[last], 2)) {
      const x = left + (width - left) * (tick - time[first]) / (time[last] - time[first]);
      add("text", {x, y: height - 5, "text-anchor": x > width - 30 ? "end" : "middle"}, `${words(tick)} s`);
    }
    names.forEach((name, k) => {
      if (!boxes[k].checked) return;
      let path = "", broken = true;
      for (let i = first; i <= last; i++) {
        const value = at(name, i);
        if (value !== null) path += `${broken ? "M" : "L"}${place(i).toFixed(1)} ${row(value).toFixed(1)}`;
        broken = value === null;
      }
      add("path", {class: `l${k}`, d: path});
    });
  };
  svg.addEventListener("pointerdown", event => { start = index(event); svg.setPointerCapture(event.pointerId); });
  svg.addEventListener("pointermove", event => {
    const now = index(event);
    svg.querySelectorAll(".mark").forEach(one => one.remove());
    add("path", {class: "axis mark", d: `M${place(now)} ${above}V${size()[1] - below}`});
    if (start !== null) {
      const [a, b] = [place(start), place(now)].sort((x, y) => x - y);
      add("rect", {class: "band mark", x: a, y: above, width: b - a, height: size()[1] - below - above});
    }
    said.textContent = [`${words(time[now])} s`, ...names.filter((_, k) => boxes[k].checked).map(
      name => `${name} ${words(at(name, now))}`)].join(", ");
  });
  svg.addEventListener("pointerup", event => {
    const now = index(event);
    if (start !== null && Math.abs(now - start) > 2) [first, last] = [Math.min(start, now), Math.max(start, now)];
    start = null;
    draw();
  });
  svg.addEventListener("pointerleave", () => { said.textContent = hint; draw(); });
  whole.addEventListener("click", () => { [first, last] = [0, time.length - 1]; draw(); });
  [...boxes, minus].forEach(box => box.addEventListener("change", draw));
  addEventListener("resize", draw);
  draw();
}
