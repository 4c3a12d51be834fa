// Analytic ray casting of convex shapes with one texture each, one sun with hard shadows, and ambient light.
//
// Rays are o + t d with d = ((u - cx) / fx, (v - cy) / fy, 1) in the camera, or (slopes, 1) where a lens bends them, so t
// is the depth z. The part of a view that never moves is traced once. A frame traces again only the pixels that a moving
// shape, or the shadow it throws on the still part, can touch, eight rays at a time: the tests are conservative, so the
// values are those of tracing everything.
#include <algorithm>
#include <vector>

#include "native.h"
#include "scenes/reach.h"

namespace {

using namespace raycast;

// The still part of the samples of one row.
void trace_still(const Tracer& tracer, const RaycastView& view, int y, const RaycastStill& out) {
  const int64_t each = int64_t(view.samples) * view.samples, first = y * view.width * each;
  for (int64_t start = first; start < first + view.width * each; start += kLanes) {
    const int count = int(std::min<int64_t>(kLanes, first + view.width * each - start));
    int64_t samples[kLanes];
    for (int i = 0; i < count; ++i) samples[i] = start + i;
    const WideVec d = tracer.rays(samples, count);
    Wide depth = wide(kInfinity);
    const Mask found = tracer.nearest(tracer.still, d, &depth);
    const Light light = tracer.seen(found, tracer.still, d, depth, count);
    for (int i = 0; i < count; ++i) {
      out.depth[start + i] = depth[i];
      out.lit[start + i] = light.lit[i];
      out.unlit[start + i] = light.unlit[i];
    }
  }
}

// The mean light of a pixel's samples.
float mean_of(const double* values, int64_t each) {
  double sum = 0;
  for (int64_t s = 0; s < each; ++s) sum += values[s];
  return float(sum / double(each));
}

// The disc across the sun's direction that the sunlit points of one pixel fill, and the mean of its samples.
void sum_up(const Tracer& tracer, const RaycastView& view, const SunPlane& plane, int64_t pixel,
            const RaycastStill& out) {
  const int64_t each = int64_t(view.samples) * view.samples;
  double least[2] = {kInfinity, kInfinity}, most[2] = {-kInfinity, -kInfinity};
  for (int64_t start = pixel * each; start < (pixel + 1) * each; start += kLanes) {
    const int count = int(std::min<int64_t>(kLanes, (pixel + 1) * each - start));
    int64_t samples[kLanes];
    for (int i = 0; i < count; ++i) samples[i] = start + i;
    const WideVec d = tracer.rays(samples, count);
    for (int i = 0; i < count; ++i) {
      if (!(out.lit[start + i] > out.unlit[start + i])) continue;
      const Vec ray{d.x[i], d.y[i], d.z[i]};
      const Vec point = Vec{view.center[0], view.center[1], view.center[2]} + out.depth[start + i] * ray;
      const double at[2] = {dot(point, plane.u), dot(point, plane.v)};
      for (int axis = 0; axis < 2; ++axis) {
        least[axis] = std::min(least[axis], at[axis]);
        most[axis] = std::max(most[axis], at[axis]);
      }
    }
  }
  const bool sunlit = most[0] >= least[0];
  for (int i = 0; i < 2; ++i) out.foot[3 * pixel + i] = sunlit ? (least[i] + most[i]) / 2 : 0;
  out.foot[3 * pixel + 2] = sunlit ? std::hypot(most[0] - least[0], most[1] - least[1]) / 2 + kSlack : -kInfinity;
  out.mean[pixel] = mean_of(out.lit + pixel * each, each);
}

// Depth and shape of the still part through the middles of a row's pixels.
void trace_middles(const Tracer& tracer, const RaycastScene& scene, const RaycastView& view, int y,
                   const RaycastStill& out) {
  const int64_t first = int64_t(y) * view.width;
  for (int64_t start = first; start < first + view.width; start += kLanes) {
    const int count = int(std::min<int64_t>(kLanes, first + view.width - start));
    int64_t pixels[kLanes];
    for (int i = 0; i < count; ++i) pixels[i] = start + i;
    Wide depth = wide(kInfinity);
    const Mask found = tracer.nearest(tracer.still, tracer.middles(pixels, count), &depth);
    for (int i = 0; i < count; ++i) {
      out.middle[start + i] = depth[i];
      out.middle_id[start + i] = found[i] < 0 ? 0 : scene.ids[found[i]];
    }
  }
}

// One row of one instant; the buffers are kept from row to row.
struct Row {
  std::vector<uint64_t> near, dark;
  std::vector<int64_t> touched, samples;
  std::vector<double> values;

  explicit Row(int64_t width) : near(width), dark(width) {}

  // The light of `count` samples, of which `near` may cover any and `dark` shade the still part of any.
  void trace(const Tracer& tracer, const RaycastStill& still, int64_t start, int count, uint64_t near_any,
             uint64_t dark_any) {
    const int64_t* which = samples.data() + start;
    Wide lit = {}, unlit = {}, still_depth = {};
    for (int i = 0; i < count; ++i)
      lit[i] = still.lit[which[i]], unlit[i] = still.unlit[which[i]], still_depth[i] = still.depth[which[i]];
    const WideVec d = tracer.rays(which, count);
    Wide depth = still_depth;
    const Mask found = tracer.nearest(near_any, d, &depth), hit = found >= every(0);
    const Mask sunlit = first_lanes(count) & ~hit & (lit > unlit);
    Wide value = lit;
    if (dark_any && any(sunlit)) value = pick(tracer.in_shadow(dark_any, d, depth, sunlit), unlit, lit);
    if (any(hit)) value = pick(hit, tracer.seen(found, tracer.moving | tracer.still, d, depth, count).lit, value);
    for (int i = 0; i < count; ++i) values[start + i] = value[i];
  }

  // The light of the pixels that something moving may touch, times the gain.
  void light(const Tracer& tracer, const RaycastView& view, const RaycastStill& still, int y, float gain, float* out) {
    const int64_t each = int64_t(view.samples) * view.samples;
    touched.clear(), samples.clear();
    for (int64_t x = 0; x < view.width; ++x) {
      if (!(near[x] | dark[x])) {
        out[x] = gain * still.mean[y * view.width + x];
        continue;
      }
      touched.push_back(x);
      for (int64_t s = 0; s < each; ++s) samples.push_back((y * int64_t(view.width) + x) * each + s);
    }
    const int64_t all = int64_t(samples.size());
    values.resize(all);
    for (int64_t start = 0; start < all; start += kLanes) {
      const int count = int(std::min<int64_t>(kLanes, all - start));
      uint64_t near_any = 0, dark_any = 0;
      for (int64_t t = start / each; t <= (start + count - 1) / each; ++t)
        near_any |= near[touched[t]], dark_any |= dark[touched[t]];
      trace(tracer, still, start, count, near_any, dark_any);
    }
    for (size_t t = 0; t < touched.size(); ++t) out[touched[t]] = gain * mean_of(values.data() + t * each, each);
  }

  // Depth (NaN where nothing is) and object of each pixel.
  void objects(const Tracer& tracer, const RaycastScene& scene, const RaycastView& view, const RaycastStill& still,
               int y, float* depth, int8_t* ids) {
    const int64_t first = int64_t(y) * view.width;
    for (int64_t start = 0; start < view.width; start += kLanes) {
      const int count = int(std::min<int64_t>(kLanes, view.width - start));
      int64_t pixels[kLanes];
      uint64_t near_any = 0;
      Wide z = wide(kInfinity);
      for (int i = 0; i < count; ++i) {
        pixels[i] = first + start + i, z[i] = still.middle[pixels[i]];
        near_any |= near[start + i];
      }
      const Mask found = near_any ? tracer.nearest(near_any, tracer.middles(pixels, count), &z) : every(-1);
      for (int i = 0; i < count; ++i) {
        depth[start + i] = z[i] < kInfinity ? float(z[i]) : std::numeric_limits<float>::quiet_NaN();
        ids[start + i] = found[i] >= 0 ? scene.ids[found[i]] : still.middle_id[pixels[i]];
      }
    }
  }
};

}  // namespace

S4_API void raycast_still(const RaycastScene* scene, const RaycastView* view, const double* rotations,
                          const double* positions, const RaycastStill* out) {
  const Tracer tracer(*scene, *view, rotations, positions);
  const SunPlane plane(scene->sun);
#pragma omp parallel for schedule(dynamic, 4) num_threads(view->threads)
  for (int y = 0; y < view->height; ++y) {
    trace_still(tracer, *view, y, *out);
    trace_middles(tracer, *scene, *view, y, *out);
    for (int64_t x = 0; x < view->width; ++x) sum_up(tracer, *view, plane, int64_t(y) * view->width + x, *out);
  }
}

// Frames of n instants, the light of each times its gain; `depth` and `ids` may both be null.
S4_API void raycast_frames(const RaycastScene* scene, const RaycastView* view, const RaycastStill* still, int64_t n,
                           const double* rotations, const double* positions, const double* gains, float* intensity,
                           float* depth, int8_t* ids) {
  const int64_t width = view->width, height = view->height, parts = (width + kSegment - 1) / kSegment;
  std::vector<Tracer> tracers;
  std::vector<std::vector<Cover>> covers(n);
  tracers.reserve(n);
  for (int64_t i = 0; i < n; ++i) {
    tracers.emplace_back(*scene, *view, rotations + 9 * i * scene->count, positions + 3 * i * scene->count);
    for (uint64_t left = tracers[i].moving; left; left &= left - 1)
      covers[i].emplace_back(tracers[i][__builtin_ctzll(left)], *view);
  }
  std::vector<Segment> segments;
  segments.reserve(height * parts);
  for (int64_t y = 0; y < height; ++y)
    for (int64_t x = 0; x < width; x += kSegment)
      segments.emplace_back(still->foot + 3 * (y * width + x), std::min<int64_t>(kSegment, width - x));
#pragma omp parallel num_threads(view->threads)
  {
    Row row(width);
#pragma omp for schedule(dynamic, 8)
    for (int64_t line = 0; line < n * height; ++line) {
      const int64_t i = line / height;
      const int y = int(line % height);
      const double* foot = still->foot + 3 * y * width;
      const Segment* parts_of_row = segments.data() + y * parts;
      mark_row(tracers[i], *view, covers[i], y, foot, parts_of_row, row.near.data(), row.dark.data());
      row.light(tracers[i], *view, *still, y, float(gains[i]), intensity + line * width);
      if (depth) row.objects(tracers[i], *scene, *view, *still, y, depth + line * width, ids + line * width);
    }
  }
}
