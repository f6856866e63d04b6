// A link that holds time and view: what stands behind # in the page's address.

export function linkOf(state, scene) {
    const parts = { time: state.time.toFixed(4) };
    if (state.camera !== null) parts.camera = `${scene.cameras[state.camera].name}`;
    else {
        const { right, down, forward, position } = state.pose;
        parts.pose = [right, down, forward, position]
            .flat()
            .map((x) => Number(x.toFixed(5)))
            .join(",");
    }
    if (state.compare !== "render") parts.compare = state.compare;
    if (state.colourBy !== "colour") parts.colours = state.colourBy;
    if (state.background !== null) parts.background = state.background.map((x) => x.toFixed(3)).join(",");
    return `#${new URLSearchParams(parts)}`;
}

// The changes that a link asks for; what it does not understand is left out.
export function stateOf(hash, scene) {
    const parts = new URLSearchParams(hash.replace(/^#/, ""));
    const changes = {};
    const numbers = (name, count) => {
        const found = (parts.get(name) ?? "").split(",").map(Number);
        return found.length === count && found.every(Number.isFinite) ? found : null;
    };
    const time = numbers("time", 1);
    if (parts.has("time") && time)
        Object.assign(changes, { time: clamp(time[0], scene.start, scene.end), playing: false });
    const camera = scene.cameras.findIndex(({ name }) => name === parts.get("camera"));
    const pose = numbers("pose", 12);
    const seen = viewOf(parts.get("view"), scene);
    if (seen) Object.assign(changes, seen, { playing: false });
    else if (camera >= 0) changes.camera = camera;
    else if (pose) {
        const [right, down, forward, position] = [0, 3, 6, 9].map((i) => pose.slice(i, i + 3));
        Object.assign(changes, { camera: null, pose: { right, down, forward, position } });
    }
    if (camera >= 0 && !parts.has("time") && scene.cameras[camera].frames.length === 1)
        Object.assign(changes, { time: scene.cameras[camera].frames[0].time, playing: false });
    if (["truth", "wipe", "beside", "difference"].includes(parts.get("compare")))
        changes.compare = parts.get("compare");
    if (["lifetime", "speed", "depth"].includes(parts.get("colours"))) changes.colourBy = parts.get("colours");
    const background = numbers("background", 3);
    if (parts.has("background") && background) changes.background = background;
    return changes;
}

// Camera and time of a view of the data set, by its name.
function viewOf(name, scene) {
    for (const [camera, { frames }] of scene.cameras.entries()) {
        const frame = frames.find(({ view }) => view === name);
        if (frame) return { camera, time: frame.time };
    }
    return null;
}

const clamp = (x, low, high) => Math.min(high, Math.max(low, x));
