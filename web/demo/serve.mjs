// Serves the package's folder for development: node demo/serve.mjs [PORT] [--isolated]
import { createReadStream, statSync } from 'node:fs';
import { createServer } from 'node:http';
import { extname, join, normalize } from 'node:path';
import { fileURLToPath } from 'node:url';

const root = fileURLToPath(new URL('..', import.meta.url));
const types = { '.html': 'text/html; charset=utf-8', '.css': 'text/css', '.js': 'text/javascript', '.mjs': 'text/javascript', '.wasm': 'application/wasm', '.svg': 'image/svg+xml', '.json': 'application/json', '.webm': 'video/webm', '.mp4': 'video/mp4', '.glb': 'model/gltf-binary' };

export function serve({ port = 8080, isolated = false, folder = root } = {}) {
  const server = createServer((request, response) => {
    let path = normalize(decodeURIComponent(new URL(request.url, 'http://x').pathname));
    if (path === '/') return response.writeHead(302, { location: '/demo/' }).end();
    if (path.endsWith('/')) path += 'index.html';
    const file = join(folder, path);
    const stat = statSync(file, { throwIfNoEntry: false });
    if (!file.startsWith(folder) || !stat?.isFile()) return response.writeHead(404).end('there is no such file');
    const headers = { 'content-type': types[extname(file)] ?? 'application/octet-stream', 'content-length': stat.size, 'cache-control': 'no-cache' };
    if (isolated) Object.assign(headers, { 'cross-origin-opener-policy': 'same-origin', 'cross-origin-embedder-policy': 'require-corp' });
    response.writeHead(200, headers);
    return createReadStream(file).pipe(response);
  });
  return new Promise((resolve) => server.listen(port, '127.0.0.1', () => resolve(server)));
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const port = Number(process.argv.slice(2).find((a) => /^\d+$/.test(a)) ?? 8080);
  await serve({ port, isolated: process.argv.includes('--isolated') });
  console.log(`http://localhost:${port}/demo/`);
}
