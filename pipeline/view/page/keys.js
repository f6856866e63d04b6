// Keys, in the order in which `?` lists them.

const FLYING = ["w", "a", "s", "d", "q", "e", "shift"];

export function listenToKeys({ transport, comparison, panel, navigation, state, actions, help }) {
    const cycle = (values, value) => values[(values.indexOf(value) + 1) % values.length];
    const compared = ["render", "truth", "wipe", "beside", "difference"];
    const colours = [...document.getElementById("colour-by").options].map((option) => option.value);
    const speeds = [...document.getElementById("speed").options].map((option) => Number(option.value));
    const faster = (by) => {
        const place = speeds.indexOf(state.speed) + by;
        state.set({ speed: speeds[Math.min(speeds.length - 1, Math.max(0, place))] });
    };
    const keys = [
        [" ", "space", "play or pause", () => transport.toggle()],
        ["arrowleft", "←", "a step back", () => transport.step(-1)],
        ["arrowright", "→", "a step on", () => transport.step(1)],
        ["arrowdown", "↓", "slower", () => faster(-1)],
        ["arrowup", "↑", "faster", () => faster(1)],
        ["[", "[", "previous camera", () => panel.next(-1)],
        ["]", "]", "next camera", () => panel.next(1)],
        [
            "t",
            "T",
            "next comparison with the truth",
            () => comparison.choose(cycle(compared, state.camera === null ? "render" : state.compare)),
        ],
        ["c", "C", "next colours", () => state.set({ colourBy: cycle(colours, state.colourBy) })],
        ["r", "R", "reset the view", actions.reset],
        ["p", "P", "screenshot", actions.screenshot],
        ["l", "L", "copy a link to time and view", actions.link],
        ["?", "?", "this list", actions.help],
    ];
    const others = [
        ["W A S D, Q E", "fly; with shift faster"],
        ["drag", "turn about the middle"],
        ["right drag, two fingers", "shift"],
        ["ctrl drag", "look around"],
        ["wheel, pinch", "approach"],
    ];
    const list = help.querySelector("dl");
    for (const [name, meaning] of [...keys.map(([, name, meaning]) => [name, meaning]), ...others]) {
        list.append(Object.assign(document.createElement("dt"), { textContent: name }));
        list.append(Object.assign(document.createElement("dd"), { textContent: meaning }));
    }
    addEventListener("keydown", (event) => {
        if (event.ctrlKey || event.metaKey || event.altKey || help.open) return;
        if (event.target.matches("select, input[type=color]")) return;
        const key = event.key.toLowerCase();
        const found = keys.find(([name]) => name === key);
        if (found) found[3]();
        else if (FLYING.includes(key)) navigation.keys.add(key);
        else return;
        if (found || event.target.matches("input")) event.preventDefault();
    });
    addEventListener("keyup", (event) => navigation.keys.delete(event.key.toLowerCase()));
}
