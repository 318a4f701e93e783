"use strict";
// The page of records: state, what is drawn from it, and the controls that change it.
(async () => {
  const by = (id) => document.getElementById(id);
  const { records } = JSON.parse(by("data").textContent);
  const PIXELS = 301; // of a map, per side
  const WIDE = 100; // a larger range of values begins in logarithms
  const DEEPEST = 1e-6; // of the largest value: the darkest colour
  const DECADES = 4; // of the lobe, where it is logarithmic
  const FATES = ["reflection", "transmission"];
  const state = { record: 0, beside: -1, theta: 0, phi: 0, channel: 0, azimuth: 0 };
  const degrees = (radians) => (radians * 180) / Math.PI;
  const short = (x) => (Number.isFinite(x) ? Number(x.toPrecision(5)).toString() : "unknown");
  const ROUNDING = 2 ** -24; // relative, of single precision

  // A number with as many digits as leave two of its error, and single precision has.
  function known(x, error) {
    if (!Number.isFinite(x) || !(error > 0)) return short(x);
    const size = Math.abs(x);
    const places = 1 - Math.floor(Math.log10(Math.max(error, ROUNDING * size)));
    const within = (n, most) => Math.min(Math.max(n, 0), most);
    if (size > 0 && (size < 1e-4 || size >= 1e7))
      return x.toExponential(within(Math.floor(Math.log10(size)) + places, 7));
    return x.toFixed(within(places, 12));
  }

  // The error of a number, or the rounding in which it is lost.
  function uncertain(x, error) {
    const rounding = ROUNDING * Math.abs(x);
    return error > 0 && error < rounding ? `<${known(rounding, rounding)}` : known(error, error);
  }

  const pointed = {}; // patch under the pointer, by map
  const plotted = { displaylogo: false, responsive: true };

  // ------------------------------------------------------------------ the numbers

  async function inflated(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  }

  for (const one of records) {
    for (const name of ["solid", "theta", "phi"])
      one[name] = new Float32Array(await inflated(one[name]));
    one.raster = new Uint32Array(await inflated(one.raster));
    one.thetas = [...new Set(one.directions.map((d) => d.theta_i))].sort((a, b) => a - b);
  }

  // Numbers of the directions with the polar angle that is chosen, by azimuth.
  function azimuths(one) {
    const theta = one.thetas[Math.min(state.theta, one.thetas.length - 1)];
    const found = [...one.directions.keys()].filter((i) => one.directions[i].theta_i === theta);
    return found.sort((a, b) => one.directions[a].phi_i - one.directions[b].phi_i);
  }

  function chosen(one) {
    const found = azimuths(one);
    return found[Math.min(state.phi, found.length - 1)];
  }

  // The direction of another record with the same incident angles, or -1.
  function same(one, direction) {
    return one.directions.findIndex(
      (d) => d.theta_i === direction.theta_i && d.phi_i === direction.phi_i);
  }

  async function unpacked(one, index) {
    const raw = await inflated(one.values[index]);
    const n = one.hemispheres * one.patches * one.channels.length;
    const part = (k) => new Float32Array(raw, 4 * k * n, n);
    return { mean: part(0), error: part(1), below: part(2), above: part(3),
             hits: new Uint32Array(raw, 16 * n) };
  }

  function patchAt(one, theta, phi) {
    const [rows, columns] = one.raster_shape;
    const row = Math.min(rows - 1, Math.floor((theta / 90) * rows));
    const turn = (((phi / 360) % 1) + 1) % 1;
    return one.raster[row * columns + (Math.floor(turn * columns) % columns)];
  }

  // What is known of one patch in the channel that is chosen.
  function reading(look, hemisphere, patch) {
    const { one, values } = look;
    const n = one.channels.length;
    const at = (hemisphere * one.patches + patch) * n + Math.min(state.channel, n - 1);
    const mean = values.mean[at];
    return { mean, error: values.error[at], low: mean - values.below[at],
             high: mean + values.above[at], solid: one.solid[patch],
             hits: values.hits[hemisphere * one.patches + patch],
             theta: one.theta[patch], phi: one.phi[patch] };
  }

  function difference(look, other, hemisphere, patch) {
    const a = reading(look, hemisphere, patch), b = reading(other, hemisphere, patch);
    return (a.mean - b.mean) / Math.hypot(a.error, b.error);
  }

  // ------------------------------------------------------------------ the maps

  const line = (n) => Array.from({ length: n }, (_, i) => -1 + (2 * i) / (n - 1));
  const axis = line(PIXELS);

  // Patch under each pixel, -1 beside the disc; once for each record.
  function pixels(one) {
    one.pixels ??= axis.map((y) => axis.map((x) => {
      const radius = Math.hypot(x, y);
      if (radius >= 1) return -1;
      const patch = patchAt(one, degrees(Math.asin(radius)), degrees(Math.atan2(y, x)));
      return patch < one.detectors ? patch : -1;
    }));
    return one.pixels;
  }

  function rows(one, of) {
    const value = Array.from({ length: one.patches }, (_, patch) => of(patch));
    return pixels(one).map((row) => row.map((patch) => (patch < 0 ? null : value[patch])));
  }

  function circle(degree) {
    const r = Math.sin((degree * Math.PI) / 180);
    return { type: "circle", x0: -r, x1: r, y0: -r, y1: r,
             line: { color: degree === 90 ? "#333" : "#fff", width: degree === 90 ? 1 : 0.5 } };
  }

  function marks(direction, hemisphere) {
    if (direction.theta_i === null) return [];
    const r = Math.sin((direction.theta_i * Math.PI) / 180);
    const phi = (direction.phi_i * Math.PI) / 180;
    const x = r * Math.cos(phi), y = r * Math.sin(phi);
    const both = hemisphere === 0;
    return [{ type: "scatter", mode: "markers", hoverinfo: "skip", showlegend: false,
              x: both ? [x, -x] : [-x], y: both ? [y, -y] : [-y],
              marker: { symbol: both ? ["circle-open", "diamond-open"] : ["diamond-open"],
                        color: "#d62728", size: 11, line: { width: 2 } } }];
  }

  function layout() {
    const plain = { visible: false, range: [-1.08, 1.08] };
    return { margin: { l: 5, r: 5, t: 32, b: 5 }, shapes: [30, 60, 90].map(circle),
             xaxis: { ...plain }, yaxis: { ...plain, scaleanchor: "x" },
             plot_bgcolor: "#fff", hovermode: "closest" };
  }

  function colours(values, name) {
    const positive = values.filter((v) => v > 0);
    const top = positive.reduce((a, b) => Math.max(a, b), 0) || 1;
    const least = positive.reduce((a, b) => Math.min(a, b), top);
    if (!by("logarithmic").checked)
      return { shown: (v) => v, zmin: 0, zmax: top, colorbar: { title: { text: name } } };
    const low = Math.floor(Math.log10(Math.max(least, DEEPEST * top)));
    const high = Math.log10(top);
    const ticks = Array.from({ length: Math.floor(high) - low + 1 }, (_, i) => low + i);
    return { shown: (v) => (v > 0 ? Math.log10(v) : null), zmin: low, zmax: high,
             colorbar: { title: { text: name }, tickvals: ticks,
                         ticktext: ticks.map((t) => `1e${t}`) } };
  }

  // Whether nothing is left to chance: integrals without a hit beside them.
  const exact = (one, hits) => one.integrals && !hits;

  function told(look, hemisphere, patch, other) {
    const r = reading(look, hemisphere, patch);
    const lines = [
      `\u03b8 ${short(r.theta)}\u00b0, \u03c6 ${short(r.phi)}\u00b0: ${known(r.mean, r.error)} \u00b1 ` +
        `${uncertain(r.mean, r.error)} 1/sr`,
      exact(look.one, r.hits) ? "\u00b1 is the largest error that the integral is estimated to have"
        : `\u00b1 is one standard error; 95 % interval ${known(r.low, r.error)} to ${known(r.high, r.error)}`,
      `${exact(look.one, r.hits) ? "integrated" : `${r.hits} rays`}, solid angle ${short(r.solid)} sr, patch ${patch}`];
    if (other)
      lines.push(`${short(difference(look, other, hemisphere, patch))} standard errors apart`);
    return lines.join("\n");
  }

  function panel(key, heading) {
    let found = by(key);
    if (!found) {
      found = document.createElement("div");
      found.className = "panel";
      found.id = key;
      found.innerHTML = `<h2></h2><div class="plot"></div><output class="readout"></output>`;
      by("maps").append(found);
    }
    found.querySelector("h2").textContent = heading;
  }

  async function drawMap({ key, look, hemisphere, picture, other }) {
    const plot = by(key).querySelector(".plot"), output = by(key).querySelector("output");
    const z = rows(look.one, (patch) => picture.shown(picture.of(patch)));
    const map = { type: "heatmap", x: axis, y: axis, z, hoverinfo: "none", zsmooth: false,
                  colorscale: picture.scale ?? "Viridis", zmin: picture.zmin,
                  zmax: picture.zmax, colorbar: { thickness: 14, ...picture.colorbar } };
    await Plotly.react(plot, [map, ...marks(look.direction, hemisphere)], layout(), plotted);
    const tell = () => { output.textContent = told(look, hemisphere, pointed[key], other); };
    if (key in pointed) tell(); // of the patch that was pointed at, in its new state
    plot.removeAllListeners("plotly_hover");
    plot.on("plotly_hover", ({ points: [at] }) => {
      const index = (v) => Math.round(((v + 1) / 2) * (PIXELS - 1));
      const patch = pixels(look.one)[index(at.y)]?.[index(at.x)] ?? -1;
      if (patch < 0) return;
      pointed[key] = patch;
      tell();
    });
  }

  // The maps of one hemisphere: of each record, and of their difference.
  function mapsOf(looks, h) {
    const [look, other] = looks;
    const has = looks.filter((l) => h < l.one.hemispheres);
    const mean = (l, patch) => reading(l, h, patch).mean;
    const seen = has.flatMap((l) => Array.from({ length: l.one.detectors }, (_, i) => mean(l, i)));
    const scale = colours(seen, h ? "BTDF (1/sr)" : "BRDF (1/sr)");
    const maps = has.map((l) => ({
      key: `map-${looks.indexOf(l)}-${h}`, look: l, hemisphere: h,
      heading: FATES[h] + (other ? `: ${l.one.title}` : ""),
      picture: { ...scale, of: (patch) => (reading(l, h, patch).hits ? mean(l, patch)
                                           : mean(l, patch) || null) } }));
    if (has.length === 2 && look.one.collector === other.one.collector)
      maps.push({
        key: `map-z-${h}`, look, hemisphere: h, heading: `${FATES[h]}: difference`, other,
        picture: { shown: (v) => (Number.isFinite(v) ? v : null), zmin: -5, zmax: 5,
                   of: (patch) => difference(look, other, h, patch), scale: "RdBu",
                   colorbar: { title: { text: "standard errors" } } } });
    return maps;
  }

  async function drawMaps(looks) {
    const hemispheres = Math.max(...looks.map((l) => l.one.hemispheres));
    const maps = [...Array(hemispheres).keys()].flatMap((h) => mapsOf(looks, h));
    const used = new Set(maps.map((map) => map.key));
    for (const old of [...by("maps").children]) if (!used.has(old.id)) old.remove();
    for (const map of maps) panel(map.key, map.heading); // all have their widths before any is drawn
    for (const map of maps) await drawMap(map);
  }

  // ------------------------------------------------------------------ cut and lobe

  // Runs of one patch along a plane, from -90 to 90 degrees of theta.
  function runs(one, azimuth, phi_i) {
    const away = Math.cos(((azimuth - phi_i) * Math.PI) / 180) > 1e-9 ? 180 : 0;
    const n = one.raster_shape[0], found = [];
    for (let i = -n; i < n; i++) {
      const angle = ((i + 0.5) * 90) / n;
      const phi = angle < 0 ? azimuth + away + 180 : azimuth + away;
      const patch = patchAt(one, Math.abs(angle), phi);
      const last = found.at(-1);
      if (last?.patch === patch) last.to = angle;
      else found.push({ patch, from: angle, to: angle });
    }
    return found.filter((run) => run.patch < one.detectors);
  }

  function curves(look, hemisphere, colour, name) {
    const { one, direction } = look;
    const cut = runs(one, state.azimuth, direction.phi_i ?? 0)
      .map((run) => ({ ...reading(look, hemisphere, run.patch), at: (run.from + run.to) / 2 }));
    const known = cut.filter((r) => r.mean !== 0);
    const empty = cut.filter((r) => r.mean === 0 && r.high > 0);
    const x = (list) => list.map((r) => r.at);
    return [
      { type: "scatter", mode: "lines+markers", name, x: x(known), y: known.map((r) => r.mean),
        marker: { size: 4, color: colour }, line: { width: 0.7, color: colour, shape: "hvh" },
        error_y: { type: "data", symmetric: false, thickness: 1, width: 2,
                   array: known.map((r) => r.high - r.mean),
                   arrayminus: known.map((r) => r.mean - r.low) } },
      { type: "scatter", mode: "markers", name: `${name}, upper limit`, x: x(empty),
        y: empty.map((r) => r.high), showlegend: false,
        marker: { size: 6, color: colour, symbol: "triangle-down-open" } }];
  }

  async function drawCut(looks) {
    const colour = [["#1f77b4", "#ff7f0e"], ["#2ca02c", "#9467bd"]];
    const traces = looks.flatMap((look, i) =>
      FATES.slice(0, look.one.hemispheres).flatMap((fate, h) =>
        curves(look, h, colour[i][h], looks.length > 1 ? `${look.one.title}, ${fate}` : fate)));
    const type = by("logarithmic").checked ? "log" : "linear";
    by("cut-value").textContent = `${state.azimuth}\u00b0`;
    by("azimuth").value = state.azimuth;
    await Plotly.react(by("cut"), traces, {
      margin: { l: 60, r: 10, t: 10, b: 40 }, legend: { orientation: "h", y: 1.02, yanchor: "bottom" },
      xaxis: { range: [-93, 93], dtick: 30, ticksuffix: "\u00b0", title: { text: "\u03b8\u2092" } },
      yaxis: { type, title: { text: "1/sr" }, exponentformat: "e",
               rangemode: type === "log" ? "normal" : "tozero" } }, plotted);
  }

  async function drawLobe(look) {
    const { one, direction } = look, traces = [];
    const hemispheres = [...Array(one.hemispheres).keys()];
    const steps = (n, end) => Array.from({ length: n }, (_, i) => (i * end) / (n - 1));
    const inside = (h) => Array.from({ length: one.detectors }, (_, p) => reading(look, h, p).mean);
    const top = hemispheres.flatMap(inside).reduce((a, b) => (b > a ? b : a), 0) || 1;
    const logarithmic = by("logarithmic").checked;
    const radius = (v) => (!(v > 0) ? 0 : !logarithmic ? v / top
                           : Math.max(0, 1 + Math.log10(v / top) / DECADES));
    for (const h of hemispheres) {
      const grid = steps(61, 90).map((theta) => steps(121, 360).map((phi) => {
        const patch = patchAt(one, Math.min(theta, 89.99), phi);
        const r = patch < one.detectors ? radius(reading(look, h, patch).mean) : 0;
        const t = (theta * Math.PI) / 180, p = (phi * Math.PI) / 180;
        return { x: r * Math.sin(t) * Math.cos(p), y: r * Math.sin(t) * Math.sin(p),
                 z: (h ? -1 : 1) * r * Math.cos(t), r };
      }));
      const of = (name) => grid.map((row) => row.map((point) => point[name]));
      traces.push({ type: "surface", x: of("x"), y: of("y"), z: of("z"), surfacecolor: of("r"),
                    cmin: 0, cmax: 1, colorscale: "Viridis", showscale: false,
                    hoverinfo: "skip" });
    }
    if (direction.theta_i !== null) {
      const t = (direction.theta_i * Math.PI) / 180, p = (direction.phi_i * Math.PI) / 180;
      traces.push({ type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false,
                    x: [0, Math.sin(t) * Math.cos(p)], y: [0, Math.sin(t) * Math.sin(p)],
                    z: [0, Math.cos(t)], line: { color: "#d62728", width: 5 } });
    }
    const none = { showticklabels: false, title: { text: "" }, range: [-1, 1] };
    const z = { ...none, range: [one.hemispheres === 2 ? -1 : 0, 1] };
    await Plotly.react(by("lobe"), traces, {
      margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, uirevision: "turned",
      scene: { camera: { eye: { x: 0.9, y: -1.3, z: 0.8 } }, xaxis: none, yaxis: none, zaxis: z, aspectmode: "manual",
               aspectratio: { x: 1, y: 1, z: one.hemispheres === 2 ? 1 : 0.5 } } }, plotted);
  }

  // ------------------------------------------------------------------ numbers as text

  function tellNumbers(look) {
    const { one, direction } = look, table = by("readings");
    table.replaceChildren();
    const add = (...cells) => {
      const row = table.insertRow();
      for (const cell of cells) row.insertCell().textContent = cell;
    };
    const { emitted } = direction.ledger;
    const certain = exact(one, emitted);
    add("", "value", certain ? "largest error" : "std_err", certain ? "limits" : "95 % interval");
    for (const name of ["dhr", "dht", "direct"])
      for (const total of direction[name] ?? [])
        add(`${name} ${one.channels.length > 1 ? total.channel : ""}`,
            known(total.value, total.std_err), uncertain(total.value, total.std_err ?? NaN),
            `${known(total.low ?? NaN, total.std_err)} to ` +
              known(total.high ?? NaN, total.std_err));
    if (certain) add("rays", "none: integrals", "", "");
    if (emitted) add("ledger, whatever power they carry", "rays", "share of rays", "");
    for (const [name, n] of Object.entries(direction.ledger))
      if (n) add(name, n.toLocaleString("en").replaceAll(",", " "),
                 `${short((100 * n) / emitted)} %`, "");
    by("text").textContent = one.text;
    by("title").textContent = one.name;
    by("notes").replaceChildren();
    for (const text of [one.left_out, ...one.warnings].filter(Boolean)) {
      const note = document.createElement("p");
      note.className = "warning";
      note.textContent = text;
      by("notes").append(note);
    }
  }

  function csv(look) {
    const header = "hemisphere,patch,theta_o,phi_o,solid_angle," +
      "value,std_err,low,high,rays";
    const lines = [header];
    for (let h = 0; h < look.one.hemispheres; h++)
      for (let patch = 0; patch < look.one.detectors; patch++) {
        const r = reading(look, h, patch);
        lines.push([FATES[h], patch, r.theta, r.phi, r.solid, r.mean, r.error, r.low, r.high,
                    r.hits].join());
      }
    return lines.join("\n") + "\n";
  }

  function download(look) {
    const { theta_i, phi_i } = look.direction, link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([csv(look)], { type: "text/csv" }));
    link.download = `theta_i_${theta_i}_phi_i_${phi_i}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  // ------------------------------------------------------------------ controls

  function controls() {
    const one = records[state.record], found = azimuths(one);
    const direction = one.directions[chosen(one)];
    const slide = (name, n, value, text) => {
      by(name).max = n - 1;
      by(name).value = value;
      by(`${name}-value`).textContent = text === null ? "as the emitter" : `${text}\u00b0`;
      by(name).hidden = n < 2;
    };
    slide("theta", one.thetas.length, state.theta, direction.theta_i);
    slide("phi", found.length, state.phi, direction.phi_i);
    by("beside-label").hidden = by("record-label").hidden = records.length < 2;
    by("channel-label").hidden = one.channels.length < 2;
    if (by("channel").dataset.of !== String(state.record)) {
      by("channel").replaceChildren(...one.channels.map((name, i) => new Option(name, i)));
      by("channel").dataset.of = state.record;
    }
  }

  let current = null, busy = false, again = false;

  async function draw() {
    if (busy) { again = true; return; } // the newest state is drawn when this one is done
    busy = true;
    do {
      again = false;
      controls();
      const one = records[state.record], index = chosen(one);
      const looks = [{ one, direction: one.directions[index],
                       values: await unpacked(one, index) }];
      const other = records[state.beside];
      const at = other && other !== one ? same(other, looks[0].direction) : -1;
      if (at >= 0) looks.push({ one: other, direction: other.directions[at],
                                values: await unpacked(other, at) });
      current = looks[0];
      tellNumbers(current);
      if (other && at < 0 && other !== one) {
        const note = document.createElement("p");
        note.textContent = `${other.title} has no such incident direction.`;
        by("notes").append(note);
      }
      await drawMaps(looks);
      await drawCut(looks);
      await drawLobe(current);
    } while (again);
    busy = false;
    document.body.dataset.drawn = `${state.record}/${state.theta}/${state.phi}`;
  }

  // The cut begins in the plane of incidence, the colours where they show most.
  function begin() {
    const one = records[state.record], direction = one.directions[chosen(one)];
    state.azimuth = Math.round((((direction.phi_i ?? 0) % 180) + 180) % 180) % 180;
  }

  async function wide() {
    const { mean } = await unpacked(records[0], 0);
    const positive = mean.filter((v) => v > 0);
    const top = positive.reduce((a, b) => Math.max(a, b), 0);
    return top > WIDE * positive.reduce((a, b) => Math.min(a, b), top);
  }

  records.forEach((one, i) => {
    one.title = `${i + 1}: ${one.label}`;
    by("record").append(new Option(one.title, i));
  });
  by("beside").append(new Option("none", -1), ...records.map((one, i) => new Option(one.title, i)));
  const numbers = ["record", "beside", "channel", "theta", "phi", "azimuth"];
  for (const name of numbers)
    by(name).addEventListener("input", () => {
      state[name] = Number(by(name).value);
      if (name === "record") {
        state.theta = state.phi = state.channel = 0;
        for (const key of Object.keys(pointed)) delete pointed[key];
      }
      if (name === "theta") state.phi = Math.min(state.phi, azimuths(records[state.record]).length - 1);
      if (name === "record" || name === "phi") begin();
      draw();
    });
  by("logarithmic").addEventListener("input", draw);
  by("csv").addEventListener("click", () => download(current));
  if (records.length === 2) by("beside").value = state.beside = 1;
  by("logarithmic").checked = await wide();
  begin();
  await draw();
})();
