// Elements by their id.

export const $ = (id) => document.getElementById(id);
