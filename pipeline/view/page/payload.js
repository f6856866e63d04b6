// Unpacks what pack.py packed: base64 and deflate, then columns of whole numbers.

export function bytesOfBase64(text) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const binary = atob(text.trim());
    const bytes = new Uint8Array(binary.length);
    for (let i = 0; i < bytes.length; ++i) bytes[i] = binary.charCodeAt(i);
    return bytes;
}

export async function inflated(bytes) {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Column name -> { step, components: Int32Array of each component }: value = step · number.
export function unpackColumns(header, bytes) {
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
