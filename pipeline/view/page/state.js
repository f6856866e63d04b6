// What the viewer shows, in one place: controls change it, and whoever listens follows.

// The page's element with this id.
export const $ = (id) => document.getElementById(id);

export class State {
    constructor(values) {
        Object.assign(this, values);
        this.listeners = [];
    }

    set(changes) {
        const changed = Object.keys(changes).filter((key) => this[key] !== changes[key]);
        if (changed.length === 0) return;
        Object.assign(this, changes);
        for (const listener of this.listeners) listener(new Set(changed));
    }

    listen(listener) {
        this.listeners.push(listener);
    }
}

// `camera` is the index of the data set's camera that is looked through, or null: then `pose` is free.
export function initialState(scene) {
    return new State({
        time: scene.start,
        playing: true,
        speed: 1,
        camera: null,
        pose: null,
        colourBy: "colour",
        compare: "render",
        wipe: 0.5,
        background: null,
    });
}
