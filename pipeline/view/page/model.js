// One model: unpacks what pack.py packed (deflate, then columns of whole numbers) into the arrays that the worker and
// the textures take.

import { meanSpeeds } from "./trajectories.js";

// seen: { start, end } of the scene's time; lifetime: half of a Gaussian's, in standard deviations.
export async function readModel(header, packed, scene) {
    const columns = unpackColumns(header, await inflated(packed));
    const motion = motionOf(header, columns, scene);
    const shared = header.trajectories ? sharedOf(header, columns.weights) : null;
    const speed = shared ? meanSpeeds(shared, motion.velocity, scene) : motion.speed;
    return {
        header,
        motion,
        shared,
        geometry: geometryOf(header.count, columns, motion),
        sh: shOf(header, columns.sh),
        shStep: columns.sh.step,
        environment: header.environment ? environmentOf(header, columns.environment) : null,
        ranges: { lifetime: quantiles(motion.sigma, Math.log), speed: quantiles(speed, (x) => x) },
    };
}

// A Gaussian is stored by the middle of the part of its line that is seen, and the way from there to its end.
function motionOf(header, columns, scene) {
    const n = header.count;
    const mean = new Float32Array(3 * n);
    const velocity = new Float32Array(3 * n);
    const meanT = new Float32Array(n);
    const sigma = new Float32Array(n).fill(Number.POSITIVE_INFINITY);
    const lifetime = new Float32Array(n).fill(Number.POSITIVE_INFINITY);
    const speed = new Float32Array(n);
    for (let i = 0; i < n; ++i) {
        let half = 0;
        let fromMiddle = 0;
        if (columns.mean_t) {
            const centre = columns.mean_t.components[0][i] * columns.mean_t.step;
            sigma[i] = Math.exp(columns.log_sigma_t.components[0][i] * columns.log_sigma_t.step);
            meanT[i] = centre;
            lifetime[i] = scene.lifetime * sigma[i];
            const first = Math.max(scene.start, centre - lifetime[i]);
            const last = Math.min(scene.end, centre + lifetime[i]);
            half = 0.5 * (last - first);
            fromMiddle = centre - 0.5 * (first + last);
        }
        for (let k = 0; k < 3; ++k) {
            if (half > 0) velocity[3 * i + k] = (columns.reach.components[k][i] * columns.reach.step) / half;
            mean[3 * i + k] = columns.middle.components[k][i] * columns.middle.step + velocity[3 * i + k] * fromMiddle;
        }
        speed[i] = Math.hypot(velocity[3 * i], velocity[3 * i + 1], velocity[3 * i + 2]);
    }
    return { mean, velocity, meanT, sigma, lifetime, speed };
}

function sharedOf({ trajectories, count: n }, column) {
    const { count, span, levels, control_points: points } = trajectories;
    const weights = new Float32Array(count * n);
    column.components.forEach((numbers, k) => {
        for (let i = 0; i < n; ++i) weights[count * i + k] = numbers[i] * column.step;
    });
    return { count, span, levels, points: new Float32Array(bytesOfBase64(points).buffer), weights };
}

// Four texels a Gaussian: mean and mean of time; velocity and 1/σt; scale and opacity; rotation as a quaternion (x, y, z, w).
function geometryOf(n, columns, motion) {
    const geometry = new Float32Array(16 * n);
    const { log_scale: logScale, rotation, opacity_logit: logit } = columns;
    for (let i = 0; i < n; ++i) {
        const at = 16 * i;
        const turn = rotation.components.map((component) => component[i] * rotation.step);
        const angle = Math.hypot(...turn);
        const sine = angle > 0 ? Math.sin(0.5 * angle) / angle : 0.5;
        for (let k = 0; k < 3; ++k) {
            geometry[at + k] = motion.mean[3 * i + k];
            geometry[at + 4 + k] = motion.velocity[3 * i + k];
            geometry[at + 8 + k] = Math.exp(logScale.components[k][i] * logScale.step);
            geometry[at + 12 + k] = turn[k] * sine;
        }
        geometry[at + 3] = motion.meanT[i];
        geometry[at + 7] = 1 / motion.sigma[i];
        geometry[at + 11] = 1 / (1 + Math.exp(-logit.components[0][i] * logit.step));
        geometry[at + 15] = Math.cos(0.5 * angle);
    }
    return geometry;
}

// A texel of RGB and one unused number for each coefficient.
function shOf(header, column) {
    const texels = header.coefficients * header.orders;
    const sh = new Int16Array(4 * texels * header.count);
    column.components.forEach((numbers, index) => {
        const first = 4 * Math.floor(index / 3) + (index % 3);
        for (let i = 0; i < header.count; ++i) sh[4 * texels * i + first] = numbers[i];
    });
    return sh;
}

function environmentOf(header, column) {
    const [height, width] = header.environment;
    const pixels = new Float32Array(4 * width * height);
    column.components.forEach((numbers, channel) => {
        for (let i = 0; i < numbers.length; ++i) pixels[4 * i + channel] = numbers[i] * column.step;
    });
    return { width, height, pixels };
}

// From the 5 % to the 95 % quantile, what colours show.
function quantiles(values, of) {
    if (values.length === 0) return [0, 1];
    const ordered = Float32Array.from(values, of).sort();
    const at = (share) => ordered[Math.floor(share * (ordered.length - 1))];
    const [low, high] = [at(0.05), at(0.95)];
    if (!Number.isFinite(low + high)) return [0, 1]; // a model without time beside one that has it
    return high > low ? [low, high] : [low, low + 1];
}

export function bytesOfBase64(text) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const binary = atob(text.trim());
    const bytes = new Uint8Array(binary.length);
    for (let i = 0; i < bytes.length; ++i) bytes[i] = binary.charCodeAt(i);
    return bytes;
}

async function inflated(bytes) {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Column name -> { step, components: Int32Array of each component }: value = step · number.
function unpackColumns(header, bytes) {
    const columns = {};
    let place = 0;
    for (const column of header.columns) {
        const rows = column.name === "environment" ? header.environment[0] * header.environment[1] : header.count;
        const components = column.low.map((low, c) => {
            const numbers = new Int32Array(rows).fill(low);
            for (let byte = 0; byte < column.bytes[c]; ++byte, place += rows)
                for (let i = 0; i < rows; ++i) numbers[i] += bytes[place + i] << (8 * byte);
            return numbers;
        });
        columns[column.name] = { step: column.step, components };
    }
    return columns;
}
