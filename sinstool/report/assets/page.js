(function () {
  "use strict";
  const root = document.documentElement;
  const NARROW = 560, PAPER_WIDTH = 660;
  const figures = [];
  let printing = false;

  function colour(name) {
    return getComputedStyle(root).getPropertyValue("--" + name).trim();
  }

  function axis(width, kind) {
    const log = kind === "log";
    return {
      gridcolor: colour("grid"), linecolor: colour("rule"), zerolinecolor: colour("rule"),
      tickcolor: colour("rule"), ticks: "outside", ticklen: 4, showline: true, automargin: true,
      exponentformat: "power", showexponent: "all",
      // plotly writes powers a quarter larger than other numbers
      tickfont: { size: fontSize(width) * (log ? 0.88 : 1) },
      title: { standoff: 8, font: { size: 13 } },
    };
  }

  function fewer(axis, width) {
    if (width >= NARROW || axis.type === "category") return Object.assign({}, axis);
    return Object.assign({}, axis, { nticks: axis.type === "log" ? 5 : 6 });
  }

  function fontSize(width) { return width < NARROW ? 11 : 12.5; }

  function layout(spec, width) {
    const size = fontSize(width);
    // Its label stands above the figure in the page: read without a turned head, and it wraps
    const yaxis = fewer(spec.yaxis, width);
    delete yaxis.title;
    // Room that ticks ask for changes the scale, the scale of a map its ticks, and so on
    const map = Boolean(yaxis.scaleanchor);
    const shown = function (kind) {
      return Object.assign(axis(width, kind), { automargin: !map });
    };
    return Object.assign({}, spec, {
      xaxis: fewer(spec.xaxis, width),
      yaxis: yaxis,
      width: width, autosize: false, uirevision: "kept", hovermode: "closest",
      showlegend: false, bargap: 0.25,
      margin: { l: map ? 58 : 48, r: 18, t: 28, b: map ? 50 : 44 },
      dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
      template: { layout: {
        font: { family: getComputedStyle(document.body).fontFamily, size: size,
                color: colour("ink") },
        paper_bgcolor: colour("page"), plot_bgcolor: colour("page"),
        xaxis: shown(spec.xaxis.type), yaxis: shown(spec.yaxis.type),
        hoverlabel: { bgcolor: colour("panel"), bordercolor: colour("rule"),
                      font: { color: colour("ink"), size: 12.5 }, align: "left" },
        modebar: { bgcolor: colour("page"), color: colour("muted"),
                   activecolor: colour("accent") },
        shapedefaults: { line: { color: colour("muted") } },
        // Pale enough that a curve is seen through it
        annotationdefaults: { font: { color: colour("muted"), size: size - 1 },
                              bgcolor: colour("page") + "a0", borderpad: 1 },
      } },
    });
  }

  function paint(trace) {
    const shade = colour("curve-" + trace.meta.colour);
    if (trace.line) trace.line.color = shade;
    else trace.marker = Object.assign({}, trace.marker, { color: shade });
  }

  const saving = {
    name: "save", title: "Save as PNG",
    click: function (plot) {
      const size = { width: 1100, height: 620 };
      const figure = figures.find(function (one) { return one.plot === plot; });
      const look = Object.assign(layout(figure.spec.layout, size.width), {
        showlegend: true, legend: { orientation: "h", y: -0.16, yanchor: "top" },
      });
      look.xaxis = Object.assign({}, look.xaxis, seen(plot.layout.xaxis));
      look.yaxis = Object.assign({}, look.yaxis, seen(plot.layout.yaxis));
      look.margin.t = 64;
      look.annotations = look.annotations.concat({
        text: "<b>" + figure.title + "</b><br>" + figure.spec.layout.yaxis.title.text,
        xref: "paper", x: 0, xanchor: "left", yref: "paper", y: 1, yanchor: "bottom", yshift: 8,
        showarrow: false, align: "left", font: { size: 14, color: colour("ink") },
      });
      const data = figure.spec.data.filter(function (trace) { return trace.visible; });
      Plotly.downloadImage({ data: data, layout: look },
        Object.assign({ format: "png", scale: 2, filename: figure.key }, size));
    },
  };

  function seen(axis) { return { range: axis.range.slice(), autorange: false }; }

  const config = {
    displaylogo: false, responsive: false, doubleClick: "reset+autosize",
    // All that there are, as plotly's own choice changes, and has held ways to send data away
    modeBarButtons: [["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"], [saving]],
  };

  function draw(figure) {
    const width = printing ? PAPER_WIDTH : figure.plot.clientWidth;
    if (!width) return Promise.resolve();
    figure.spec.data.forEach(paint);
    const look = layout(figure.spec.layout, width);
    look.height = figure.plot.clientHeight;
    return Plotly.react(figure.plot, figure.spec.data, look, config);
  }

  function drawAll() { return figures.reduce(
    function (before, figure) { return before.then(function () { return draw(figure); }); },
    Promise.resolve()); }

  function showLegend(figure) {
    figure.buttons.forEach(function (button, k) {
      button.setAttribute("aria-pressed", String(figure.spec.data[k].visible));
    });
  }

  function answer(figure) {
    figure.buttons.forEach(function (button, k) {
      const data = figure.spec.data;
      button.disabled = false;
      button.addEventListener("click", function (event) {
        if (event.shiftKey || event.altKey) {
          const alone = data.every(function (one, j) { return one.visible === (j === k); });
          data.forEach(function (one, j) { one.visible = alone || j === k; });
        } else data[k].visible = !data[k].visible;
        showLegend(figure);
        draw(figure);
      });
    });
  }

  function unpacked(name) {
    const text = atob(document.getElementById(name).textContent);
    const bytes = Uint8Array.from(text, function (sign) { return sign.charCodeAt(0); });
    const flow = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(flow).arrayBuffer();
  }

  function numbersOf(place, block) {
    const size = place.type === "f8" ? 8 : 4, n = place.n;
    const bytes = new Uint8Array(n * size);
    for (let k = 0; k < size; k++)
      for (let i = 0; i < n; i++) bytes[i * size + k] = block[place.at + k * n + i];
    if (place.steps) {
      const bits = new Uint32Array(bytes.buffer);
      for (let i = 1; i < n; i++) bits[i] += bits[i - 1];
    }
    return size === 8 ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
  }

  async function start() {
    if (document.getElementById("library")) {
      const library = document.createElement("script");
      library.textContent = new TextDecoder().decode(await unpacked("library"));
      document.head.append(library);
    }
    saving.icon = Plotly.Icons.camera;
    const block = new Uint8Array(await unpacked("numbers"));
    document.querySelectorAll(".drawing").forEach(function (plot) {
      const holder = plot.closest("figure");
      const spec = JSON.parse(holder.querySelector("script").textContent);
      spec.data.forEach(function (trace) {
        for (const axis of ["x", "y"])
          if (!Array.isArray(trace[axis])) trace[axis] = numbersOf(trace[axis], block);
      });
      const figure = {
        plot: plot, key: plot.dataset.key, title: plot.dataset.title, spec: spec,
        buttons: holder.querySelectorAll(".legend button"),
      };
      figures.push(figure);
      answer(figure);
    });
    await drawAll();
    root.dataset.figures = "drawn";
  }

  let waiting = 0, width = window.innerWidth;
  addEventListener("resize", function () {
    // A telephone's address bar changes the height alone
    if (window.innerWidth === width) return;
    width = window.innerWidth;
    clearTimeout(waiting);
    waiting = setTimeout(drawAll, 120);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);

  function print(now) {
    printing = now;
    root.classList.toggle("printing", now);
    // Paper has nothing to click on: settings at their defaults are printed too
    document.querySelectorAll("details.kept").forEach(function (one) {
      if (now) { one.dataset.was = one.open; one.open = true; }
      else one.open = one.dataset.was === "true";
    });
    // Not one after the other: the browser takes the page as it is when this returns
    figures.forEach(draw);
  }
  addEventListener("beforeprint", function () { print(true); });
  addEventListener("afterprint", function () { print(false); });

  start();
})();
