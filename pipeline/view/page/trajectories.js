// Trajectories that Gaussians share, rasterizer/trajectories.py: sums of uniform cubic B-splines in time.

const TIMES = 8; // within the scene, at which speeds are measured

// shared: { count, span, levels, points (C, count, 6), weights (N, count) }; levels: intervals of each. Three texels a trajectory: displacement, rotation
// vector, and velocity of the displacement.
export function tableAt({ count, span: [start, end], levels, points }, time) {
    const table = new Float32Array(12 * count);
    const u = (time - start) / (end - start);
    const slope = u >= 0 && u <= 1 ? 1 / (end - start) : 0;
    let first = 0;
    for (const intervals of levels) {
        const at = Math.min(Math.max(u, 0), 1) * intervals;
        const begun = Math.min(Math.floor(at), intervals - 1);
        const v = at - begun;
        const w = 1 - v;
        const values = [w ** 3, 3 * v ** 3 - 6 * v ** 2 + 4, 3 * w ** 3 - 6 * w ** 2 + 4, v ** 3];
        const slopes = [-3 * w ** 2, 9 * v ** 2 - 12 * v, 12 * w - 9 * w ** 2, 3 * v ** 2];
        for (let p = 0; p < 4; ++p)
            for (let k = 0; k < count; ++k)
                for (let axis = 0; axis < 3; ++axis) {
                    const point = 6 * (count * (first + begun + p) + k) + axis;
                    table[12 * k + axis] += (values[p] / 6) * points[point];
                    table[12 * k + 4 + axis] += (values[p] / 6) * points[point + 3];
                    table[12 * k + 8 + axis] += ((slopes[p] * slope * intervals) / 6) * points[point];
                }
        first += intervals + 3;
    }
    return table;
}

// How much each trajectory takes a Gaussian of weight 1 along `direction`, at a time.
export function displacedAlong(shared, time, [x, y, z]) {
    const table = tableAt(shared, time);
    return Float64Array.from(
        { length: shared.count },
        (_, k) => x * table[12 * k] + y * table[12 * k + 1] + z * table[12 * k + 2],
    );
}

// Mean over the scene's time of a Gaussian's speed, its own velocity (3 N) included.
export function meanSpeeds(shared, velocity, scene) {
    const { count, weights } = shared;
    const speeds = new Float32Array(velocity.length / 3);
    for (let t = 0; t < TIMES; ++t) {
        const time = scene.start + ((t + 0.5) / TIMES) * (scene.end - scene.start);
        const table = tableAt(shared, time);
        for (let i = 0; i < speeds.length; ++i) {
            let [x, y, z] = velocity.subarray(3 * i, 3 * i + 3);
            for (let k = 0; k < count; ++k) {
                const weight = weights[count * i + k];
                x += weight * table[12 * k + 8];
                y += weight * table[12 * k + 9];
                z += weight * table[12 * k + 10];
            }
            speeds[i] += Math.hypot(x, y, z) / TIMES;
        }
    }
    return speeds;
}
