// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0

// Makes the plots over time of a report interactive. page.py writes the JSON block "content". All plots share one time
// axis: each shows the same interval, unless it has no data there.
'use strict';
(() => {
  const plots = JSON.parse(document.getElementById('content').textContent);
  const panels = [];
  const GUTTER = 62, INK = '#1a1a1a', PALE = '#dddddd', FONT = '11px system-ui, sans-serif';
  const element = (tag, parent, text = '', others = {}) => {
    const child = Object.assign(document.createElement(tag), { textContent: text, ...others });
    parent.append(child);
    return child;
  };
  const button = (parent, text, title, act) =>
    element('button', parent, text, { type: 'button', title, ariaLabel: title, onclick: act });
  const signed = (number) => String(number).replace('-', '−');
  document.documentElement.classList.add('scripted');

  function zoom(low, high) {
    for (const { chart, extent: [first, last] } of panels) {
      if (low === null) chart.setScale('x', { min: first, max: last });
      else if (low < last && high > first) chart.setScale('x', { min: low, max: high });
    }
  }
  // Widens the shown interval of a panel by a factor, and moves it by a fraction of its length.
  function move({ chart, extent: [first, last] }, factor, part) {
    const { min, max } = chart.scales.x, all = last - first;
    const width = Math.min(Math.max((max - min) * factor, 1e-3 * all), all); // the thinned data have no finer detail
    const low = (min + max - width) / 2 + part * (max - min), begin = Math.min(Math.max(low, first), last - width);
    if (width < all) zoom(begin, begin + width); else zoom(null);
  }

  // Writes the values nearest to a time above each panel.
  function read({ chart, outputs }, t) {
    for (const [{ y }, output] of outputs) {
      const at = t === null ? null : y[chart.valToIdx(t)];
      output.textContent = at === null ? '' : signed(at.toPrecision(4));
    }
  }

  function series(line) {
    const how = { stroke: line.colour, width: line.style === 'band' ? 0 : line.width, points: { show: false } };
    if (line.style === 'steps') how.paths = uPlot.paths.stepped({ align: 1 });
    if (line.style === 'dots') Object.assign(how, { paths: () => null, points: { show: true, size: 5, fill: line.colour } });
    return how;
  }

  function legend(head, colour, label, name = 'swatch') {
    const item = element('span', head);
    element('i', item, '', { className: name }).style.background = colour;
    item.append(label);
    return item;
  }

  // Shades spans below the lines; a span of length 0 is a line.
  function shade({ ctx, bbox, scales, valToPos }, spans) {
    const place = (t) => valToPos(Math.min(Math.max(t, scales.x.min), scales.x.max), 'x', true);
    for (const [begin, end, colour] of spans) {
      if (end < scales.x.min || begin > scales.x.max) continue;
      ctx.fillStyle = colour;
      ctx.fillRect(place(begin), bbox.top, Math.max(place(end) - place(begin), 1), bbox.height);
    }
  }

  function addPanel(box, plot, data, last, extent) {
    const head = element('div', box, '', { className: 'head' });
    element('b', head, data.label);
    const panel = { extent };
    panel.outputs = data.lines.filter(({ style }) => style !== 'dots' && style !== 'band').map((line) => [
      line, element('output', legend(head, line.colour, line.label)),
    ]);
    const table = [data.t, ...data.lines.flatMap(({ y, upper }) => (upper ? [y, upper] : [y]))];
    const lines = [{}, ...data.lines.flatMap((line) => (line.upper ? [series(line), series(line)] : [series(line)]))];
    // A band is the first line of its panel.
    const bands = data.lines.filter(({ upper }) => upper).map(({ colour }) => ({ series: [2, 1], fill: colour + '40' }));
    const tick = { stroke: INK, font: FONT, grid: { stroke: PALE, width: 1 }, ticks: { show: false } };
    const followed = ['mousemove', 'mouseleave'];
    panel.chart = new uPlot({
      width: Math.max(box.clientWidth, 200), height: last ? 138 : 104, legend: { show: false }, bands, series: lines,
      padding: [4, 10, last ? 0 : 4, 0],
      scales: { x: { time: false, min: extent[0], max: extent[1] }, y: data.reach ? { range: data.reach } : {} },
      axes: [last ? { ...tick, label: 'time [s]', labelFont: FONT, labelSize: 16, size: 24 } : { ...tick, size: 0, values: () => [] },
        { ...tick, size: GUTTER, space: 26, values: (chart, ticks) => ticks.map((y) => signed(+y.toPrecision(6))) }],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false },
        sync: { key: 'time', filters: { pub: (kind) => followed.includes(kind) } },
        bind: { dblclick: () => () => { zoom(null); return null; } } },
      hooks: {
        setSelect: [(chart) => {
          const { left, width } = chart.select;
          if (width > 3) zoom(chart.posToVal(left, 'x'), chart.posToVal(left + width, 'x'));
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [({ cursor, posToVal }) => read(panel, cursor.left >= 0 ? posToVal(cursor.left, 'x') : null)],
        drawClear: [(chart) => shade(chart, plot.spans)],
      },
    }, table, box);
    panels.push(panel);
    return panel;
  }

  function addPlot(box, plot) {
    const tools = element('div', box, '', { className: 'tools' });
    const times = plot.panels.flatMap(({ t }) => [t[0], t.at(-1)]).filter(isFinite);
    const extent = [Math.min(...times), Math.max(...times)];
    const kinds = new Map(plot.spans.filter(([, , , label]) => label).map(([, , colour, label]) => [label, colour]));
    for (const [label, colour] of kinds) legend(tools, colour, label, 'swatch broad');
    const added = plot.panels.map((data, k) => addPanel(box, plot, data, k === plot.panels.length - 1, extent));
    const acts = [['−', 'zoom out', '-', 1.6, 0], ['+', 'zoom in', '+', 1 / 1.6, 0], ['‹', 'earlier', 'ArrowLeft', 1, -0.25],
      ['›', 'later', 'ArrowRight', 1, 0.25], ['all', 'show all', 'Home', Infinity, 0]];
    for (const [sign, title, , ...how] of acts) button(tools, sign, title, () => move(added[0], ...how));
    box.tabIndex = 0;
    box.addEventListener('keydown', (event) => {
      const act = event.target === box && acts.find(([, , key]) => key === event.key);
      if (!act) return;
      event.preventDefault();
      move(added[0], ...act.slice(3));
    });
    box.charts = added.map(({ chart }) => chart);
    const fit = () => box.charts.forEach((chart) => {
      const width = box.clientWidth;
      if (width && chart.width !== width) chart.setSize({ width, height: chart.height });
    });
    new ResizeObserver(fit).observe(box);
  }

  for (const box of document.querySelectorAll('[data-plot]')) addPlot(box, plots[box.dataset.plot]);
  for (const each of document.querySelectorAll('[data-copy]')) {
    each.addEventListener('click', async () => {
      await navigator.clipboard.writeText(each.dataset.copy);
      each.textContent = 'copied';
    });
  }
})();
