// A plain C++ rasteriser to measure against: colour and centre depth, 16 x 16 tiles, sorted list per tile, front to
// back, gradients per intersection. The loop over a tile row's 16 pixels is left to the compiler to vectorise.
#include <algorithm>
#include <cmath>
#include <cstdint>

namespace {
constexpr int TILE = 16, PIXELS = TILE * TILE;
constexpr float MIN_ALPHA = 1.0f / 255.0f, MAX_ALPHA = 0.99f, MIN_TRANSMITTANCE = 1e-4f;

// x, y, conic (xx, xy, yy), opacity, r, g, b, depth
struct Gaussian { float x, y, a, b, c, opacity, red, green, blue, depth; };

inline void rows_of(const Gaussian& g, int top, int& first, int& stop) {
    const float det = g.a * g.c - g.b * g.b;
    const float half = std::sqrt(2.0f * std::log(255.0f * g.opacity) * g.a / det);
    first = std::max(0, (int)std::ceil(g.y - half - 0.5f) - top);
    stop = std::min(TILE, (int)std::floor(g.y + half - 0.5f) - top + 1);
}

bool opaque(const float* transmittance) {
    float highest = 0.0f;
    for (int k = 0; k < PIXELS; ++k) highest = std::max(highest, transmittance[k]);
    return highest < MIN_TRANSMITTANCE;
}
}  // namespace

extern "C" void forward(const Gaussian* gaussians, const int32_t* starts, const int32_t* ids, int width, int height,
                        float* color, float* depth, float* alpha, int32_t* looked_at) {
    const int columns = (width + TILE - 1) / TILE, rows = (height + TILE - 1) / TILE;
#pragma omp parallel for schedule(dynamic, 4)
    for (int tile = 0; tile < columns * rows; ++tile) {
        const int left = tile % columns * TILE, top = tile / columns * TILE;
        alignas(64) float t[PIXELS], red[PIXELS] = {}, green[PIXELS] = {}, blue[PIXELS] = {}, z[PIXELS] = {};
        for (int k = 0; k < PIXELS; ++k) t[k] = left + k % TILE < width && top + k / TILE < height;
        int k = starts[tile];
        for (; k < starts[tile + 1]; ++k) {
            const Gaussian g = gaussians[ids[k]];
            int first, stop;
            rows_of(g, top, first, stop);
            for (int row = first; row < stop; ++row) {
                const float dy = top + row + 0.5f - g.y;
#pragma omp simd
                for (int lane = 0; lane < TILE; ++lane) {
                    const int p = row * TILE + lane;
                    const float dx = left + lane + 0.5f - g.x;
                    const float power = -0.5f * (g.a * dx * dx + g.c * dy * dy) - g.b * dx * dy;
                    float opacity = std::min(MAX_ALPHA, g.opacity * std::exp(power));
                    opacity = opacity >= MIN_ALPHA && t[p] >= MIN_TRANSMITTANCE ? opacity : 0.0f;
                    const float weight = opacity * t[p];
                    t[p] -= weight;
                    red[p] += weight * g.red;
                    green[p] += weight * g.green;
                    blue[p] += weight * g.blue;
                    z[p] += weight * g.depth;
                }
            }
            if ((k - starts[tile]) % 8 == 7 && opaque(t)) { ++k; break; }
        }
        looked_at[tile] = k - starts[tile];
        for (int row = 0; row < TILE && top + row < height; ++row)
            for (int lane = 0; lane < TILE && left + lane < width; ++lane) {
                const int p = row * TILE + lane, at = (top + row) * width + left + lane;
                color[3 * at] = red[p];
                color[3 * at + 1] = green[p];
                color[3 * at + 2] = blue[p];
                depth[at] = z[p];
                alpha[at] = 1.0f - t[p];
            }
    }
}

extern "C" void backward(const Gaussian* gaussians, const int32_t* starts, const int32_t* ids, int width, int height,
                         const int32_t* looked_at, const float* color, const float* depth, const float* g_color,
                         const float* g_depth, float* out) {
    const int columns = (width + TILE - 1) / TILE, rows = (height + TILE - 1) / TILE;
#pragma omp parallel for schedule(dynamic, 4)
    for (int tile = 0; tile < columns * rows; ++tile) {
        const int left = tile % columns * TILE, top = tile / columns * TILE;
        alignas(64) float t[PIXELS] = {}, rest[PIXELS] = {}, g_red[PIXELS] = {}, g_green[PIXELS] = {}, g_blue[PIXELS] = {},
                          g_z[PIXELS] = {};
        for (int row = 0; row < TILE && top + row < height; ++row)
            for (int lane = 0; lane < TILE && left + lane < width; ++lane) {
                const int p = row * TILE + lane, at = (top + row) * width + left + lane;
                t[p] = 1.0f;
                g_red[p] = g_color[3 * at];
                g_green[p] = g_color[3 * at + 1];
                g_blue[p] = g_color[3 * at + 2];
                g_z[p] = g_depth[at];
                rest[p] = g_red[p] * color[3 * at] + g_green[p] * color[3 * at + 1] + g_blue[p] * color[3 * at + 2] +
                          g_z[p] * depth[at];
            }
        for (int k = starts[tile]; k < starts[tile + 1]; ++k) {
            float sums[10] = {};
            if (k - starts[tile] < looked_at[tile]) {
                const Gaussian g = gaussians[ids[k]];
                int first, stop;
                rows_of(g, top, first, stop);
                float s_red = 0, s_green = 0, s_blue = 0, s_z = 0, q0 = 0, qx = 0, qy = 0, qxx = 0, qxy = 0, qyy = 0;
                for (int row = first; row < stop; ++row) {
                    const float dy = top + row + 0.5f - g.y;
#pragma omp simd reduction(+ : s_red, s_green, s_blue, s_z, q0, qx, qy, qxx, qxy, qyy)
                    for (int lane = 0; lane < TILE; ++lane) {
                        const int p = row * TILE + lane;
                        const float dx = left + lane + 0.5f - g.x;
                        const float power = -0.5f * (g.a * dx * dx + g.c * dy * dy) - g.b * dx * dy;
                        const float bare = g.opacity * std::exp(power);
                        float opacity = std::min(MAX_ALPHA, bare);
                        opacity = opacity >= MIN_ALPHA && t[p] >= MIN_TRANSMITTANCE ? opacity : 0.0f;
                        const float before = t[p], weight = opacity * before;
                        t[p] = before - weight;
                        const float s = g_red[p] * g.red + g_green[p] * g.green + g_blue[p] * g.blue + g_z[p] * g.depth;
                        s_red += weight * g_red[p];
                        s_green += weight * g_green[p];
                        s_blue += weight * g_blue[p];
                        s_z += weight * g_z[p];
                        rest[p] -= weight * s;
                        const float by_alpha = before * s - rest[p] / (1.0f - opacity);
                        const float q = bare < MAX_ALPHA ? by_alpha * opacity : 0.0f;
                        q0 += q;
                        qx += q * dx;
                        qy += q * dy;
                        qxx += q * dx * dx;
                        qxy += q * dx * dy;
                        qyy += q * dy * dy;
                    }
                }
                const float found[10] = {q0, qx, qy, qxx, qxy, qyy, s_red, s_green, s_blue, s_z};
                std::copy(found, found + 10, sums);
            }
            std::copy(sums, sums + 10, out + 10 * (int64_t)k);
        }
    }
}
