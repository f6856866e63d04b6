// A worker: which Gaussians are in view at a time, nearest first. The rules are the kernel's: p(t) >= 0.05, in front of
// the near plane, ordered by the depth of the mean in float32.

// mean (3 N), velocity (3 N), meanT, lifetime (N): time from meanT at which p(t) is 0.05, weights (N K) if shared
let gaussians = null;
let ids, depths, keys, sorted, counts;

self.onmessage = ({ data }) => {
    if (data.gaussians) load(data.gaussians);
    else self.postMessage(sort(data), [data.order.buffer]);
};

function load(loaded) {
    gaussians = loaded;
    const count = gaussians.meanT.length;
    [ids, keys, sorted] = Array.from({ length: 3 }, () => new Uint32Array(count));
    depths = new Float32Array(count);
    counts = new Uint32Array(1 << 16);
}

// view: { time, forward [3], offset, along [K], near, order }. Depth is forward · x + offset + weights · along. `order`
// is written and sent back.
function sort(view) {
    const { mean, velocity, meanT, lifetime, weights } = gaussians;
    const { along } = view;
    const [fx, fy, fz] = view.forward;
    let count = 0;
    let alive = 0;
    for (let i = 0; i < meanT.length; ++i) {
        const elapsed = view.time - meanT[i];
        if (Math.abs(elapsed) > lifetime[i]) continue;
        ++alive;
        const k = 3 * i;
        const x = mean[k] + velocity[k] * elapsed;
        const y = mean[k + 1] + velocity[k + 1] * elapsed;
        const z = mean[k + 2] + velocity[k + 2] * elapsed;
        let depth = fx * x + fy * y + fz * z + view.offset;
        for (let j = 0; j < along.length; ++j) depth += weights[along.length * i + j] * along[j];
        if (!(depth > view.near)) continue;
        depths[count] = depth;
        ids[count++] = i;
    }
    radixSort(count, view.order);
    const at = (share) => depths[sorted[Math.min(count - 1, Math.floor(share * count))]];
    return { count, alive, depths: count ? [at(0.01), at(0.9)] : [0, 1], order: view.order };
}

// Positive floats sort as their bits do: two stable passes of 16 bits.
function radixSort(count, order) {
    const bits = new Uint32Array(depths.buffer);
    for (let i = 0; i < count; ++i) keys[i] = i;
    pass(count, keys, sorted, bits, 0);
    pass(count, sorted, keys, bits, 16);
    [keys, sorted] = [sorted, keys];
    for (let i = 0; i < count; ++i) order[i] = ids[sorted[i]];
}

function pass(count, from, to, bits, shift) {
    counts.fill(0);
    for (let i = 0; i < count; ++i) ++counts[(bits[i] >>> shift) & 0xffff];
    let total = 0;
    for (let digit = 0; digit < counts.length; ++digit) {
        const here = counts[digit];
        counts[digit] = total;
        total += here;
    }
    for (let i = 0; i < count; ++i) to[counts[(bits[from[i]] >>> shift) & 0xffff]++] = from[i];
}
