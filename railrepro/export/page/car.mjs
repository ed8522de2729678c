// The car and its controllers in JavaScript: WebAssembly modules that are stepped like the FMUs, the controller before the car,
// each by 1 ms. SI units, torques traction-positive, y to the right.
//
//   load(content)                 prepare the data that `python -m railrepro live` wrote to content.json
//   Unit.of(given, cells)         the car or a controller: set(name, value), start(), step(), inputs, outputs, parameter(name)
//   settings(loaded, figure)      the committed settings of a run, to be changed and given to `drive`
//   drive(loaded, settings)       an async generator of rows, see ROW, which returns why the run ended. The controller "own" calls
//                                 the function settings.law each millisecond. It takes [front, rear], the measured quantities of
//                                 both gears, and returns their differential torques (N m), or a promise of them
//   changes(loaded, settings)     parameters of car and controller that follow from the settings
//   lawOf(text)                   such a function from the text of a law, in a browser; its `end()` ends its worker
//   score(rows)                   errors, delay, distance, torques

export const ROW = ["t", "p", "v", "y_ref", "y", "psi", "du", "tau_le", "tau_ri", "f_le", "f_ri", "sx_le", "sx_ri", "y_rear", "psi_rear"];
const MS = 1e-3, DERAILED = 0.03, PATIENCE = 3;

/* Bytes of an embedded text. */
async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return await new Response(stream).arrayBuffer();
}

export const numbers = async (text) => new Float64Array(await unpacked(text));

export async function load(content) {
  const module = async (of) => ({ ...of, module: await WebAssembly.compile(await unpacked(of.module)) });
  const all = async (group, each) => Object.fromEntries(await Promise.all(Object.entries(group).map(async ([k, v]) => [k, await each(v)])));
  const figure = async (of) => ({ ...of, cells: await numbers(of.cells) });
  const [car, controllers, figures] = await Promise.all([module(content.car), all(content.controllers, module), all(content.figures, figure)]);
  return { ...content, car, controllers, figures };
}

export class Unit {
  static async of(given, cells) {
    const imports = {};  // of a WASI module; it never calls them
    for (const i of WebAssembly.Module.imports(given.module)) (imports[i.module] ??= {})[i.name] = () => 0;
    const unit = new Unit(), { exports } = await WebAssembly.instantiate(given.module, imports);
    const at = (pointer, n) => new Float64Array(exports.memory.buffer, pointer, n);
    exports._initialize?.();
    exports.reset();
    const inputs = given.outputs ? 4 : given.n_inputs, outputs = given.outputs?.length ?? 4;
    unit.inputs = at(exports.inputs(), inputs), unit.outputs = at(exports.outputs(), outputs);
    unit.held = exports.held && at(exports.held(), 2);
    unit.numbers = at(exports.parameters(), given.parameters.length);
    unit.places = new Map(given.parameters.map(({ name }, i) => [name, i]));
    at(exports.cells(), cells.length).set(cells);
    unit.exports = exports;
    return unit;
  }
  set(name, value) {
    if (!this.places.has(name)) throw Error(`there is no parameter ${name}`);
    this.numbers[this.places.get(name)] = value;
  }
  parameter(name) { return this.numbers[this.places.get(name)]; }
  start() { this.exports.begin(); }
  step() { return this.exports.step(1); }
}

export function settings(loaded, figure, controller = "nmpc") {
  const { speed_kmh, set_point } = loaded.figures[figure];
  return { figure, controller, speed_kmh, amplitude_mm: set_point.amplitude_mm, force: 1, r: 1, faster: 1, car: {}, law: null };
}

export function changes(loaded, s) {
  const stated = new Map(loaded.controllers[s.controller].parameters.map((p) => [p.name, p.value]));
  const car = { ...s.car, speed: s.speed_kmh / 3.6 }, controller = {};
  if (s.car["drive.torque_limit"]) controller["drive.torque_limit"] = s.car["drive.torque_limit"];
  if (stated.has("cost.r") && s.r !== 1) controller["cost.r"] = s.r * stated.get("cost.r");
  if (stated.has("lateral.k0") && s.faster !== 1)
    for (const [name, power] of [["k2", 1], ["k1", 2], ["k0", 3], ["ki", 4]])
      controller[`lateral.${name}`] = s.faster ** power * stated.get(`lateral.${name}`);
  return { car, controller };
}

/* The route of a figure with its set point and force demand scaled according to the settings. */
function laid(loaded, s) {
  const { cells, set_point } = loaded.figures[s.figure], road = Float64Array.from(cells), width = loaded.columns.length;
  const scale = (name, factor) => { for (let i = loaded.columns.indexOf(name); i < road.length; i += width) road[i] *= factor; };
  if (set_point.amplitude_mm) for (const name of ["y_ref", "dy_ref", "ddy_ref", "dddy_ref"]) scale(name, s.amplitude_mm / set_point.amplitude_mm);
  scale("force", s.force);
  return road;
}

/* A law from its text, in a separate worker: whatever the text does, it can return only torques. A worker from a data: address has a
   separate origin, so it shares no storage with the page, and the policy of the page permits no network. */
export function lawOf(text) {
  const worker = new Worker(`data:text/javascript;charset=utf-8,${encodeURIComponent(`"use strict";
    onmessage = ({ data }) => {
      try { postMessage(data.map((q, gear) => law(q, memories[gear]))); }
      catch (fault) { postMessage(String(fault?.message ?? fault)); }
    };
    const memories = [{}, {}], law = (q, memory) => {\n${text}\n};`)}`);
  const law = (gears) => new Promise((give, refuse) => {
    const fail = (why) => { clearTimeout(late), refuse(Error(`The law ${why}.`)); }, at = `at p = ${gears[0].p.toFixed(1)} m`;
    const late = setTimeout(() => fail(`gave no torque for ${PATIENCE} s ${at}`), 1e3 * PATIENCE);
    worker.onmessage = ({ data }) => { typeof data === "string" ? fail(`stopped ${at}: ${data}`) : (clearTimeout(late), give(data)); };
    worker.onerror = (event) => { event.preventDefault(), fail(`cannot be read: ${event.message}`); };
    worker.postMessage(gears);
  });
  law.end = () => worker.terminate();
  return law;
}

export async function* drive(loaded, s) {
  const of = loaded.figures[s.figure], width = loaded.columns.length, { car: names } = loaded;
  const given = { ...loaded.controllers[s.controller], n_inputs: names.measured.length };
  const road = laid(loaded, s), changed = changes(loaded, s);
  const [car, law] = await Promise.all([Unit.of(names, road), Unit.of(given, road)]);
  for (const [unit, of] of [[car, changed.car], [law, changed.controller]]) for (const [name, value] of Object.entries(of)) unit.set(name, value);
  car.start(), law.start();
  const own = s.controller === "own", limit = car.parameter("drive.torque_limit");
  const place = (name) => names.outputs.indexOf(name), measured = names.measured.map(place), column = loaded.columns;
  const y0 = column.indexOf("y_ref"), kappa = column.indexOf("kappa");
  const cell = (p) => width * Math.min(Math.max(Math.floor((p - road[0]) / 0.5), 0), road.length / width - 1);
  const reference = (p) => {
    const i = cell(p) + y0, d = p - road[cell(p)], [y, y1, y2, y3] = road.subarray(i, i + 4);
    return [y + d * (y1 + d * (y2 / 2 + d * y3 / 6)), y1 + d * (y2 + d * y3 / 2), y2 + d * y3];
  };
  const gear = (name) => Object.fromEntries(["p", "v", "y", "psi_TrAx", "psidot_Ax"].map((key) => [key, place(`${name}.${key}`)]));
  const gears = [gear("front"), gear("rear")], seen = ["front_le.adhesion", "front_ri.adhesion", "front_le.sx", "front_ri.sx"].map(place);
  for (let k = 0; ; k++) {
    const x = car.outputs, [front, rear] = gears, stop = of.stop_kmh / 3.6 || -1;
    for (let i = 0; i < measured.length; i++) law.inputs[i] = x[measured[i]];
    if (own) {
      const asked = gears.map((at) => {
        const p = x[at.p], [y_ref, dy_ref, ddy_ref] = reference(p);
        return { t: k * MS, p, v: x[at.v], y: x[at.y], psi: x[at.psi_TrAx], r: x[at.psidot_Ax], kappa: road[cell(p) + kappa], y_ref, dy_ref, ddy_ref, limit };
      });
      const torques = await s.law(asked);
      for (const [g, { p }] of asked.entries()) {
        const torque = torques?.[g];
        if (!Number.isFinite(torque)) throw Error(`The law returned ${torque} at p = ${p.toFixed(1)} m; a torque (N m) is needed.`);
        law.held[g] = Math.min(Math.max(torque, -limit), limit);
      }
    }
    const failed = law.step(), [le, ri] = law.outputs;
    const beyond = x[front.p] >= of.end, slow = x[front.v] <= stop, off = Math.max(Math.abs(x[front.y]), Math.abs(x[rear.y])) >= DERAILED;
    if (k % of.stride === 0 || beyond || slow || off)
      yield [k * MS, x[front.p], x[front.v], reference(x[front.p])[0], x[front.y], x[front.psi_TrAx], (le - ri) / 2, le, ri,
             ...seen.map((i) => x[i]), x[rear.y], x[rear.psi_TrAx]];
    if (off) return "A running gear derailed.";
    if (beyond) return "End of the track.";
    if (slow) return "The car stands.";
    if (failed || k > 600e3) return "The run was ended.";
    car.inputs.set(law.outputs);
    if (car.step()) return "A number of the car left all bounds.";
  }
}

/* RMSE and largest error (mm), delay (m), RMS and largest torque (N m), distance (m), time (s). */
export function score(rows) {
  const of = (name) => rows.map((row) => row[ROW.indexOf(name)]), y = of("y"), y_ref = of("y_ref"), p = of("p"), du = of("du");
  const rms = (values) => Math.sqrt(values.reduce((sum, v) => sum + v * v, 0) / values.length);
  const error = y.map((value, i) => value - y_ref[i]);
  return {
    rmse_mm: 1e3 * rms(error), largest_mm: 1e3 * Math.max(...error.map(Math.abs)), delay_m: delay(p, y, y_ref),
    du_rms_Nm: rms(du), du_largest_Nm: Math.max(...du.map(Math.abs)), way_m: p.at(-1) - p[0], time_s: rows.at(-1)[0],
  };
}

/* Distance (m) by which y trails its set point, as metrics.delay: the lag within 60 m with the largest mean product of both, on a
   grid of 0.1 m and without their linear trends. */
function delay(p, y, y_ref) {
  const step = 0.1, n = Math.ceil((p.at(-1) - p[0]) / step), most = Math.min(600, n >> 1), middle = (n - 1) / 2;
  let k = 0;
  const grid = Array.from({ length: n }, (_, i) => {
    while (k < p.length - 2 && p[k + 1] < p[0] + i * step) k++;
    return [k, (p[0] + i * step - p[k]) / (p[k + 1] - p[k] || 1)];
  });
  const detrended = (values) => {
    const on = grid.map(([at, part]) => values[at] + part * (values[at + 1] - values[at]));
    const mean = on.reduce((a, b) => a + b, 0) / n;
    const slope = 12 * on.reduce((sum, v, i) => sum + v * (i - middle), 0) / (n * (n * n - 1));
    return on.map((v, i) => v - mean - slope * (i - middle));
  };
  const a = detrended(y), b = detrended(y_ref);
  if (Math.max(...b) - Math.min(...b) < 1e-9) return NaN;
  let best = [-Infinity, 0];
  for (let lag = -most; lag <= most; lag++) {
    let sum = 0, count = 0;
    for (let i = Math.max(lag, 0); i < n + Math.min(lag, 0); i++) sum += a[i] * b[i - lag], count++;
    if (sum / count > best[0]) best = [sum / count, lag];
  }
  return best[1] * step;
}
