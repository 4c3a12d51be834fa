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

Wide loaded(const double* from, int count) {
  Wide found = {};
  for (int i = 0; i < count; ++i) found[i] = from[i];
  return found;
}

// The mean light of a pixel's samples.
float mean_of(const double* values, int64_t each) {
  double sum = 0;
  for (int64_t s = 0; s < each; ++s) sum += values[s];
  return float(sum / double(each));
}

// One row of one instant; the buffers are kept from row to row.
class Row {
 public:
  Row(const RaycastScene& scene, const RaycastView& view, const Slopes& slopes, const RaycastStill& still)
      : near(view.width), dark(view.width), scene_(scene), view_(view), slopes_(slopes), still_(still),
        each_(int64_t(view.samples) * view.samples), u_(view.width * each_), v_(u_.size()), values_(u_.size()) {
    samples_.reserve(u_.size());
  }

  std::vector<uint64_t> near, dark;  // see mark_row

  // Trace the still part.
  void trace_still(const Tracer& tracer, const SunPlane& plane, int y) {
    const int64_t first = int64_t(y) * view_.width, all = view_.width * each_;
    for (int64_t x = 0; x < view_.width; ++x) slopes_.of_samples(x, y, &u_[x * each_], &v_[x * each_]);
    for (int64_t start = 0; start < all; start += kLanes) {
      const int count = int(std::min<int64_t>(kLanes, all - start));
      const WideVec d = tracer.rays(loaded(&u_[start], count), loaded(&v_[start], count));
      Wide depth = wide(kInfinity);
      const Mask found = tracer.nearest(tracer.still, d, &depth);
      const Light light = tracer.seen(found, tracer.still, d, depth, count);
      for (int i = 0; i < count; ++i) {
        const int64_t to = first * each_ + start + i;
        still_.depth[to] = depth[i], still_.lit[to] = light.lit[i], still_.unlit[to] = light.unlit[i];
      }
    }
    for (int64_t x = 0; x < view_.width; ++x) sum_up(plane, first + x, x);
    for (int64_t start = 0; start < view_.width; start += kLanes) {
      const int count = int(std::min<int64_t>(kLanes, view_.width - start));
      Wide depth = wide(kInfinity);
      const Mask found = tracer.nearest(tracer.still, middles(tracer, start, count, y), &depth);
      for (int i = 0; i < count; ++i) {
        still_.middle[first + start + i] = depth[i];
        still_.middle_id[first + start + i] = found[i] < 0 ? 0 : scene_.ids[found[i]];
      }
    }
  }

  // The light of each pixel, times the gain; only those that something moving may touch are traced.
  void light(const Tracer& tracer, int y, float gain, float* out) {
    const int64_t first = int64_t(y) * view_.width;
    samples_.clear(), touched_.clear();
    for (int64_t x = 0; x < view_.width; ++x) {
      if (!(near[x] | dark[x])) {
        out[x] = gain * still_.mean[first + x];
        continue;
      }
      slopes_.of_samples(x, y, &u_[samples_.size()], &v_[samples_.size()]);
      for (int64_t s = 0; s < each_; ++s) samples_.push_back((first + x) * each_ + s);
      touched_.push_back(x);
    }
    const int64_t all = int64_t(samples_.size());
    for (int64_t start = 0; start < all; start += kLanes) {
      const int count = int(std::min<int64_t>(kLanes, all - start));
      uint64_t near_any = 0, dark_any = 0;
      for (int64_t t = start / each_; t <= (start + count - 1) / each_; ++t)
        near_any |= near[touched_[t]], dark_any |= dark[touched_[t]];
      trace(tracer, start, count, near_any, dark_any);
    }
    for (size_t t = 0; t < touched_.size(); ++t) out[touched_[t]] = gain * mean_of(&values_[t * each_], each_);
  }

  // Depth (NaN where nothing is) and object of each pixel.
  void objects(const Tracer& tracer, int y, float* depth, int8_t* ids) const {
    const int64_t first = int64_t(y) * view_.width;
    for (int64_t start = 0; start < view_.width; start += kLanes) {
      const int count = int(std::min<int64_t>(kLanes, view_.width - start));
      uint64_t near_any = 0;
      for (int i = 0; i < count; ++i) near_any |= near[start + i];
      Wide z = loaded(still_.middle + first + start, count);
      const Mask found = near_any ? tracer.nearest(near_any, middles(tracer, start, count, y), &z) : every(-1);
      for (int i = 0; i < count; ++i) {
        depth[start + i] = z[i] < kInfinity ? float(z[i]) : std::numeric_limits<float>::quiet_NaN();
        ids[start + i] = found[i] >= 0 ? scene_.ids[found[i]] : still_.middle_id[first + start + i];
      }
    }
  }

 private:
  WideVec middles(const Tracer& tracer, int64_t start, int count, int y) const {
    double u[kLanes], v[kLanes];
    for (int i = 0; i < count; ++i) slopes_.of_middle(start + i, y, u + i, v + i);
    return tracer.rays(loaded(u, count), loaded(v, count));
  }

  // The disc across the sun's direction that the sunlit points of a pixel fill, and the mean of its samples.
  void sum_up(const SunPlane& plane, int64_t pixel, int64_t x) {
    double least[2] = {kInfinity, kInfinity}, most[2] = {-kInfinity, -kInfinity};
    for (int64_t s = 0; s < each_; ++s) {
      const int64_t sample = pixel * each_ + s;
      if (!(still_.lit[sample] > still_.unlit[sample])) continue;
      const Vec d = turn_back(view_.rotation, Vec{u_[x * each_ + s], v_[x * each_ + s], 1});
      const Vec point = Vec{view_.center[0], view_.center[1], view_.center[2]} + still_.depth[sample] * d;
      const double at[2] = {dot(point, plane.u), dot(point, plane.v)};
      for (int i = 0; i < 2; ++i) {
        least[i] = std::min(least[i], at[i]);
        most[i] = std::max(most[i], at[i]);
      }
    }
    const bool sunlit = most[0] >= least[0];
    double* foot = still_.foot + 3 * pixel;
    for (int i = 0; i < 2; ++i) foot[i] = sunlit ? (least[i] + most[i]) / 2 : 0;
    foot[2] = sunlit ? std::hypot(most[0] - least[0], most[1] - least[1]) / 2 + kSlack : -kInfinity;
    still_.mean[pixel] = mean_of(still_.lit + pixel * each_, each_);
  }

  // The light of `count` samples; shapes of `near_any` may cover them, and those of `dark_any` shade their still part.
  void trace(const Tracer& tracer, int64_t start, int count, uint64_t near_any, uint64_t dark_any) {
    const int64_t* which = samples_.data() + start;
    Wide lit = {}, unlit = {}, depth = {};
    for (int i = 0; i < count; ++i)
      lit[i] = still_.lit[which[i]], unlit[i] = still_.unlit[which[i]], depth[i] = still_.depth[which[i]];
    const WideVec d = tracer.rays(loaded(&u_[start], count), loaded(&v_[start], count));
    const Mask found = tracer.nearest(near_any, d, &depth), hit = found >= every(0);
    const Mask sunlit = first_lanes(count) & ~hit & (lit > unlit);
    Wide value = lit;
    if (dark_any && any(sunlit)) value = pick(tracer.in_shadow(dark_any, d, depth, sunlit), unlit, lit);
    if (any(hit)) value = pick(hit, tracer.seen(found, tracer.moving | tracer.still, d, depth, count).lit, value);
    for (int i = 0; i < count; ++i) values_[start + i] = value[i];
  }

  const RaycastScene& scene_;
  const RaycastView& view_;
  const Slopes& slopes_;
  const RaycastStill& still_;
  int64_t each_;  // samples of a pixel
  std::vector<double> u_, v_, values_;
  std::vector<int64_t> samples_, touched_;
};

}  // namespace

S4_API void raycast_still(const RaycastScene* scene, const RaycastView* view, const double* rotations,
                          const double* positions, const RaycastStill* out) {
  const Pyramid textures(scene->textures, scene->texture_count, scene->texture_size, scene->levels);
  const Tracer tracer(*scene, *view, textures, rotations, positions);
  const SunPlane plane(scene->sun);
  const Slopes slopes(*view);
#pragma omp parallel num_threads(view->threads)
  {
    Row row(*scene, *view, slopes, *out);
#pragma omp for schedule(dynamic, 4)
    for (int y = 0; y < view->height; ++y) row.trace_still(tracer, plane, y);
  }
}

// Frames of n instants, the light of each times its gain; `depth` and `ids` may both be null.
S4_API void raycast_frames(const RaycastScene* scene, const RaycastView* view, const RaycastStill* still, int64_t n,
                           const double* rotations, const double* positions, const double* gains, float* intensity,
                           float* depth, int8_t* ids) {
  const int64_t width = view->width, height = view->height, parts = (width + kSegment - 1) / kSegment;
  const Pyramid textures(scene->textures, scene->texture_count, scene->texture_size, scene->levels);
  std::vector<Tracer> tracers;
  std::vector<std::vector<Cover>> covers(n);
  tracers.reserve(n);
  for (int64_t i = 0; i < n; ++i) {
    const int64_t first = i * scene->count;
    tracers.emplace_back(*scene, *view, textures, rotations + 9 * first, positions + 3 * first);
    for (uint64_t left = tracers[i].moving; left; left &= left - 1)
      covers[i].emplace_back(tracers[i][__builtin_ctzll(left)], *view);
  }
  std::vector<Segment> segments;
  segments.reserve(height * parts);
  for (int64_t y = 0; y < height; ++y)
    for (int64_t x = 0; x < width; x += kSegment)
      segments.emplace_back(still->foot + 3 * (y * width + x), std::min<int64_t>(kSegment, width - x));
  const Slopes slopes(*view);
#pragma omp parallel num_threads(view->threads)
  {
    Row row(*scene, *view, slopes, *still);
#pragma omp for schedule(dynamic, 8)
    for (int64_t line = 0; line < n * height; ++line) {
      const int64_t i = line / height;
      const int y = int(line % height);
      const double* foot = still->foot + 3 * y * width;
      const Segment* parts_of_row = segments.data() + y * parts;
      mark_row(tracers[i], *view, covers[i], y, foot, parts_of_row, row.near.data(), row.dark.data());
      row.light(tracers[i], y, float(gains[i]), intensity + line * width);
      if (depth) row.objects(tracers[i], y, depth + line * width, ids + line * width);
    }
  }
}
