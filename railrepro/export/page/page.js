const byId = (id) => document.getElementById(id);
const coreUrl = URL.createObjectURL(new Blob([byId("core").textContent], { type: "text/javascript" }));
const { ROW, numbers, score, settings } = await import(coreUrl);
const content = JSON.parse(byId("content").textContent);
const COLORS = ["#0072b2", "#d55e00", "#009e73"], GREY = "#8a8a8a", MOST = 3, MARGIN = 2;
const EXAMPLE = `// proportional to the error, with yaw angle and yaw rate against track and set point as damping
const e = q.y_ref - q.y, course = q.dy_ref - q.psi, turn = q.v * (q.kappa + q.ddy_ref) - q.r;
return 3e5 * e + 3e4 * q.v * course + 1e3 * q.v * turn;`;

/* Values that can be changed: key in the settings, text, ends and step of the slider, and condition for their use. The permitted
   ranges are content.ranges, those of the library. */
const VALUES = [
  { key: "speed_kmh", text: "speed (km/h)", low: 20, high: 430, step: 1 },
  { key: "amplitude_mm", text: "amplitude of the set point (mm)", low: 0.1, high: 6, step: 0.1 },
  { key: "force", text: "force demand, factor", low: 0, high: 2, step: 0.05, if: (s) => content.figures[s.figure].force },
  { key: "r", text: "R of the predictive controllers, factor", low: 1e-3, high: 1e4, log: true },
  { key: "faster", text: "poles of NDI, factor", low: 0.1, high: 5, step: 0.05 },
  { key: "adhesion.good.mu0", text: "friction of dry rail", low: 0.05, high: 0.6, step: 0.005, car: true },
  { key: "adhesion.poor.mu0", text: "friction of poor rail", low: 0.03, high: 0.4, step: 0.005, car: true, if: (s) => s.figure === "adhesion_loss" },
  { key: "drive.torque_limit", text: "torque limit of a motor (N m)", low: 500, high: 8000, step: 50, car: true },
  { key: "drive.lag", text: "lag of the drives (s)", low: 0.001, high: 0.05, step: 0.001, car: true },
  { key: "body.mass", text: "mass of the car body (kg)", low: 12000, high: 60000, step: 500, car: true },
];
const labels = Object.fromEntries(Object.entries(content.controllers).map(([name, { label }]) => [name, label]));
const stated = new Map(content.car.parameters.map((p) => [p.name, p.value]));
const committedOf = (v, figure) => v.car ? stated.get(v.key) : settings(content, figure)[v.key];

let state, started = EXAMPLE;  // the law that may run: the example, or what was there when Run was pressed
let runs = [], workers = [], pointed = null, plots = [];

/* Take a value from a field or a link. Returns the reason if it is refused. */
function put(v, x) {
  const { low, high, closed, signed } = content.ranges[v.key], size = signed ? Math.abs(x) : x;
  if (!(Number.isFinite(x) && (size > low || (closed && size === low)) && size <= high))
    return `${v.text}: a number${signed ? " of either sign" : ""} ${closed ? "from" : "above"} ${low} up to ${high} is needed.`;
  if (x === committedOf(v, state.figure)) delete state.values[v.key]; else state.values[v.key] = x;
}

/* Take the state from the link of the page. Returns the reasons for what is refused; it keeps its initial value. */
function restore() {
  state = { figure: "curve_entry_T3", shown: ["nmpc", "ndi"], values: {}, law: EXAMPLE };
  const known = (name, of) => typeof name === "string" && Object.hasOwn(of, name);
  const fits = {
    figure: (x) => known(x, content.figures), law: (x) => typeof x === "string",
    shown: (x) => Array.isArray(x) && x.length <= MOST && new Set(x).size === x.length && x.every((name) => known(name, labels)),
  };
  try {
    const link = JSON.parse(decodeURIComponent(location.hash.slice(1)) || "{}"), { values = {}, ...rest } = link;
    if (![link, values].every((each) => each.constructor === Object)) throw Error("no table");
    const why = [];
    for (const [key, x] of Object.entries(rest))
      if (Object.hasOwn(fits, key) && fits[key](x)) state[key] = x; else why.push(`${key} of the link is unknown here.`);
    for (const [key, x] of Object.entries(values)) {
      const v = shownValues().find((each) => each.key === key);
      why.push(v ? put(v, x) : `${key} of the link is no value of this experiment.`);
    }
    return why.filter(Boolean);
  } catch { return ["The link cannot be read."]; }
}
function remember() { history.replaceState(null, "", "#" + encodeURIComponent(JSON.stringify(state))); }

/* Settings of a run from the values that differ from the committed ones. */
function asked(controller) {
  const s = { ...settings(content, state.figure, controller), law: started };
  for (const v of shownValues()) {
    if (!(v.key in state.values)) continue;
    if (v.car) s.car[v.key] = state.values[v.key];
    else s[v.key] = state.values[v.key];
  }
  return s;
}
const shownValues = () => VALUES.filter((v) => committedOf(v, state.figure) !== undefined && (v.if?.(settings(content, state.figure)) ?? true));
const isCommitted = (run) => run.controller !== "own" && Object.keys(state.values).length === 0;

function slider(v) {
  const committed = committedOf(v, state.figure), box = document.createElement("label");
  const to = (x) => (v.log ? Math.log10(x) : x), from = (x) => (v.log ? Number((10 ** x).toPrecision(3)) : x);
  box.className = "slider";
  box.innerHTML = `<span>${v.text}</span><input type="range" min="${to(v.low)}" max="${to(v.high)}" step="${v.log ? 0.05 : v.step}">
    <input type="number" step="any" aria-label="${v.text}"><button type="button" title="committed: ${committed}" aria-label="committed value of ${v.text}">↺</button>`;
  const [range, number, back] = box.querySelectorAll("input, button");
  const show = (x) => { range.value = to(x), number.value = x; box.classList.toggle("changed", x !== committed); };
  const take = (x) => {
    const refused = put(v, x);
    show(state.values[v.key] ?? committed), say(refused ?? "");
    return !refused;
  };
  range.addEventListener("input", () => take(from(Number(range.value))));
  range.addEventListener("change", () => run());
  number.addEventListener("change", () => take(number.valueAsNumber) && run());
  back.addEventListener("click", () => take(committed) && run());
  show(state.values[v.key] ?? committed);
  return box;
}

function build() {
  byId("figure").replaceChildren(...Object.entries(content.figures).map(([name, { title }]) => new Option(title, name, false, name === state.figure)));
  const boxes = Object.entries(labels).map(([name, label]) => {
    const box = document.createElement("label");
    box.innerHTML = `<input type="checkbox" value="${name}"> ${label}`;
    box.firstChild.checked = state.shown.includes(name);
    return box;
  });
  byId("controllers").replaceChildren(byId("controllers").firstElementChild, ...boxes);
  byId("sliders").replaceChildren(byId("sliders").firstElementChild, ...shownValues().map(slider));
  byId("law").value = state.law;
  byId("own").open = state.shown.includes("own");
}
function say(text) { byId("message").textContent = text; }

/* One worker for each run, so that the page never waits. Workers keep their compiled modules. */
function worker(i) {
  if (workers[i]) return workers[i];
  // a worker cannot import from a file, so it contains the text
  const text = byId("core").textContent.replaceAll(/^export /gm, "") + `
    let loaded, current = 0;
    onmessage = async ({ data }) => {
      if (data.content) return void (loaded = load(data.content));
      const mine = current = data.number; let law = null;
      try {
        if (data.settings.controller === "own") law = lawOf(data.settings.law);
        const rows = drive(await loaded, { ...data.settings, law }); let block = [], sent = performance.now();
        for (;;) {
          const { done, value } = await rows.next();
          if (mine !== current) return;
          if (!done) block.push(value);
          if (done || performance.now() - sent > 40) {
            postMessage({ number: mine, block, ended: done ? value : null }), block = [], sent = performance.now();
            await new Promise((then) => setTimeout(then));
          }
          if (done) return;
        }
      } catch (fault) { postMessage({ number: mine, block: [], fault: fault.message.slice(0, 300) }); }
      finally { law?.end(); }
    };`;
  const made = new Worker(URL.createObjectURL(new Blob([text], { type: "text/javascript" })));
  made.postMessage({ content });
  made.onmessage = ({ data }) => take(i, data);
  made.onerror = (event) => { take(i, { number, block: [], fault: `The run failed: ${event.message}.` }), end(i); };
  return (workers[i] = made);
}
function end(i) { workers[i]?.terminate(), delete workers[i]; }

let number = 0;
function run(said = []) {
  remember();
  number++;
  runs.forEach((one, i) => { if (one.controller === "own" && !one.ended) end(i); });  // a law may never return
  const waits = (controller) => controller === "own" && state.law !== started;
  runs = state.shown.map((controller) => ({ controller, rows: [], ended: waits(controller) ? "Waits for Run." : null, fault: null, number, begun: performance.now() }));
  runs.forEach((one, i) => { if (!one.ended) worker(i).postMessage({ number, settings: asked(one.controller) }); });
  say([...said, ...(state.shown.some(waits) ? ["The law is shown, not started: read it, then press Run."] : [])].join(" "));
  byId("stop").disabled = runs.every((one) => one.ended);
  table([]), draw();
}
function stop() {
  number++;
  workers.forEach((_, i) => end(i));
  runs.forEach((one) => (one.ended ??= "Stopped."));
  byId("stop").disabled = true;
  table([]), draw();
}
function take(i, { number: of, block, ended, fault }) {
  const one = runs[i];
  if (!one || one.number !== of) return;
  for (const row of block) one.rows.push(row);
  if (fault) one.fault = fault, say(fault);
  if (ended || fault) one.ended = ended ?? "Stopped.", one.seconds = (performance.now() - one.begun) / 1e3;
  if (runs.every((each) => each.ended)) byId("stop").disabled = true;
  draw();
}

const col = Object.fromEntries(ROW.map((name, i) => [name, i]));
const numbersOf = new Map();
async function committedRun(figure, controller) {
  const key = [figure, controller].join();
  if (!numbersOf.has(key)) {
    const of = content.figures[figure].committed[controller];
    numbersOf.set(key, of ? { y: await numbers(of.y), p: await numbers(of.p) } : null);
  }
  return numbersOf.get(key);
}

/* Interpolate values linearly at a grid of coordinates; null beyond the rows. */
function onGrid(grid, p, values) {
  let k = 0;
  return grid.map((x) => {
    while (k < p.length - 2 && p[k + 1] < x) k++;
    if (p.length < 2 || x < p[0] || x > p[k + 1]) return null;
    return values[k] + ((values[k + 1] - values[k]) * (x - p[k])) / (p[k + 1] - p[k] || 1);
  });
}

const PLOTS = [
  { title: "lateral position y (mm)", of: (row) => 1e3 * row[col.y], reference: true },
  { title: "error y - y* (mm)", of: (row) => 1e3 * (row[col.y] - row[col.y_ref]) },
  { title: "yaw angle against the track (mrad)", of: (row) => 1e3 * row[col.psi] },
  { title: "differential torque (N m)", of: (row) => row[col.du] },
  { title: "adhesion of the left front wheel", of: (row) => row[col.f_le] },
];

let waiting = false;
function draw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(async () => { waiting = false; await drawNow(); });
}
async function drawNow() {
  const end = content.figures[state.figure].end, grid = Array.from({ length: 701 }, (_, i) => (end * i) / 700);
  const p = runs.map((one) => one.rows.map((row) => row[col.p]));
  const before = await Promise.all(runs.map((one) => committedRun(state.figure, one.controller)));
  const ink = getComputedStyle(document.body).color, axis = { stroke: ink, grid: { stroke: "#8883" }, ticks: { stroke: "#8883" } };
  const width = byId("plots").clientWidth;
  PLOTS.forEach((plot, n) => {
    const data = [grid], series = [{ label: "p (m)" }];
    const add = (label, values, look) => { data.push(values), series.push({ label, points: { show: false }, ...look }); };
    if (plot.reference) {
      before.forEach((run, i) => run && !isCommitted(runs[i]) &&
        add(`${labels[runs[i].controller]}, committed`, onGrid(grid, run.p, run.y.map((y) => 1e3 * y)), { stroke: COLORS[i] + "66", width: 2.5 }));
      if (runs[0]) add("set point", onGrid(grid, p[0], runs[0].rows.map((row) => 1e3 * row[col.y_ref])), { stroke: ink, dash: [2, 4] });
    }
    runs.forEach((one, i) => add(labels[one.controller], onGrid(grid, p[i], one.rows.map(plot.of)), { stroke: COLORS[i], width: 1.4 }));
    const key = series.map((s) => s.label).join("|") + state.figure + width + ink;
    if (plots[n]?.key !== key) {
      plots[n]?.plot.destroy();
      const options = { width, height: n ? 150 : 210, title: plot.title, series, axes: [axis, { ...axis, size: 60 }], scales: { x: { time: false } },
                        legend: { show: n === 0 }, cursor: { sync: { key: "p" } }, hooks: { setCursor: [(u) => { pointed = u.cursor.idx == null ? null : grid[u.cursor.idx]; plan(); }] } };
      const place = byId("plots").children[n] ?? byId("plots").appendChild(document.createElement("div"));
      plots[n] = { key, plot: new uPlot(options, data, place) };
    } else plots[n].plot.setData(data);
  });
  table(before), plan();
}

function table(before) {
  const text = (x, digits) => (Number.isFinite(x) ? x.toFixed(digits) : "");
  byId("scores").tBodies[0].replaceChildren(...runs.map((one, i) => {
    const row = document.createElement("tr"), found = one.rows.length > MARGIN ? score(one.rows) : {};
    let said = one.fault ? (one.controller === "own" ? "The law failed." : "The run failed.") : one.ended ?? "running …";
    if (one.ended && one.seconds && one.rows.length && !one.fault) {
      said += ` ${(one.rows.at(-1)[0] / one.seconds).toFixed(1)} times real time.`;
      if (isCommitted(one) && before[i]) said += before[i].y.every((y, k) => one.rows[k]?.[col.y] === y) ? " Equal to the committed run." : " Differs from the committed run.";
    }
    row.innerHTML = `<td><span class="swatch"></span>${labels[one.controller]}</td><td>${text(found.rmse_mm, 3)}</td>
      <td>${text(found.largest_mm, 2)}</td><td>${text(found.delay_m, 1)}</td><td>${text(found.du_rms_Nm, 0)}</td><td>${text(found.way_m, 1)}</td><td></td>`;
    row.querySelector("span").style.background = COLORS[i];
    row.lastElementChild.textContent = said;
    return row;
  }));
}

/* Both running gears from above: 1 mm to the side is as long as 1 m along the track; yaw angles are 100 times as large. */
function plan() {
  const canvas = byId("plan"), pen = canvas.getContext("2d"), rows = runs[0]?.rows ?? [];
  canvas.width = canvas.clientWidth * devicePixelRatio, canvas.height = canvas.clientHeight * devicePixelRatio;
  pen.scale(devicePixelRatio, devicePixelRatio);
  if (!rows.length) return;
  const at = pointed == null ? rows.length - 1 : Math.max(0, rows.findIndex((row) => row[col.p] >= pointed) + rows.length) % rows.length;
  const row = rows[at], scale = 6, middle = canvas.clientHeight / 2, x0 = canvas.clientWidth - 60, ink = getComputedStyle(document.body).color, half = 42;
  const gap = stated.get("body.gear_spacing");
  const x = (p) => x0 + (p - row[col.p]) * scale, y = (mm) => middle + mm * scale;
  pen.strokeStyle = GREY, pen.lineWidth = 2;
  for (const side of [-half, half]) pen.beginPath(), pen.moveTo(0, middle + side), pen.lineTo(canvas.clientWidth, middle + side), pen.stroke();
  pen.setLineDash([2, 4]), pen.strokeStyle = ink, pen.lineWidth = 1, pen.beginPath();
  for (let k = Math.max(0, at - 200); k < Math.min(rows.length, at + 40); k++) pen.lineTo(x(rows[k][col.p]), y(1e3 * rows[k][col.y_ref]));
  pen.stroke(), pen.setLineDash([]);
  const gear = (p, mm, psi) => {
    pen.save(), pen.translate(x(p), y(mm)), pen.rotate(100 * psi), pen.fillStyle = COLORS[0];
    for (const side of [-half, half]) pen.fillRect(-10, side - 4, 20, 8);
    pen.fillRect(-2, -half, 4, 2 * half), pen.restore();
  };
  gear(row[col.p], 1e3 * row[col.y], row[col.psi]);
  gear(row[col.p] - gap, 1e3 * row[col.y_rear], row[col.psi_rear]);
  pen.fillStyle = ink, pen.font = "12px system-ui", pen.fillText(`p = ${row[col.p].toFixed(1)} m, y = ${(1e3 * row[col.y]).toFixed(2)} mm, v = ${(3.6 * row[col.v]).toFixed(0)} km/h, t = ${row[0].toFixed(2)} s`, 8, 16);
}

byId("settings").addEventListener("submit", (event) => { event.preventDefault(); state.law = started = byId("law").value; run(); });
byId("stop").addEventListener("click", stop);
byId("committed").addEventListener("click", () => { state.values = {}, build(), run(); });
byId("figure").addEventListener("change", (event) => { state.figure = event.target.value, state.values = {}, build(), run(); });
byId("law").addEventListener("change", () => { state.law = byId("law").value, remember(); });
byId("controllers").addEventListener("change", (event) => {
  const chosen = [...byId("controllers").querySelectorAll("input:checked")].map((box) => box.value);
  if (chosen.length > MOST) { event.target.checked = false; return say(`Up to ${MOST} controllers are shown.`); }
  state.shown = chosen, byId("own").open = chosen.includes("own"), run();
});
byId("sliders").open = innerWidth > 900;
addEventListener("resize", draw);
function open() { const said = restore(); build(), run(said); }
addEventListener("hashchange", open);
open();
