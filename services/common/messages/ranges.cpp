#include "common/messages/ranges.hpp"

#include <cmath>
#include <cstdint>
#include <span>
#include <string_view>

#include "common/geometry/imu_limits.hpp"
#include "common/messages/convert.hpp"
#include "common/messages/keys.hpp"

namespace zloam {
namespace {

// Maximum magnitudes: beyond any place, speed or error on earth, and far below where squares and
// products overflow.
constexpr double kMost_m = 1e7;
constexpr double kMostOfTwist = 1e4;
constexpr double kMostOfNumber = 1e15;
constexpr float kMostOfPoint_m = 1e6F;
// Times from days before 1970 (recordings may begin at 0, and offsets go below) to the year 2096:
// sums of two and differences do not overflow.
constexpr std::int64_t kLeast_ns = -1'000'000'000'000'000;
constexpr std::uint32_t kLeastPeriod_ns = 1'000'000;
constexpr std::int64_t kMost_ns = 4'000'000'000'000'000'000;

/// Keeps the first error found.
class Checker {
 public:
  Checker& require(bool ok, std::string_view what) {
    if (!ok && error_.empty()) error_ = what;
    return *this;
  }

  Checker& header(const msg::Header* h) {
    if (h == nullptr) return require(false, "the header is missing");
    require(h->robot() != nullptr && h->robot()->size() > 0, "header.robot is missing");
    require(h->instance() != nullptr && h->instance()->size() > 0, "header.instance is missing");
    require(h->frame() != nullptr, "header.frame is missing");
    return time(h->stamp_ns(), "header.stamp_ns")
        .time(h->last_packet_ns(), "header.last_packet_ns");
  }

  Checker& time(std::int64_t time_ns, std::string_view name) {
    return time_ns >= kLeast_ns && time_ns <= kMost_ns
               ? *this
               : require(false, std::string(name) + " is no time of this century");
  }

  Checker& finite(double value, std::string_view name) {
    return std::isfinite(value) ? *this : require(false, std::string(name) + " is not finite");
  }

  Checker& within(double value, double most, std::string_view name) {
    // Written so that NaN fails too.
    return std::abs(value) <= most
               ? *this
               : require(false, std::string(name) + " is not finite or too large");
  }

  /// Velocities and their variances are divided by the period.
  Checker& period(std::uint32_t period_ns, std::size_t points) {
    return require(points == 0 || period_ns >= kLeastPeriod_ns, "period_ns is below a millisecond");
  }

  Checker& vec(const msg::Vec3* v, std::string_view name, double most = kMost_m) {
    if (v == nullptr) return *this;
    return within(v->x(), most, name).within(v->y(), most, name).within(v->z(), most, name);
  }

  Checker& pose(const msg::Pose* p, std::string_view name) {
    if (p == nullptr) return require(false, std::string(name) + " is missing");
    return pose(*p, name);
  }

  Checker& pose(const msg::Pose& p, std::string_view name) {
    vec(&p.translation(), name);
    const msg::Quat& q = p.rotation();
    const double norm = std::sqrt(q.x() * q.x() + q.y() * q.y() + q.z() * q.z() + q.w() * q.w());
    // Written so that NaN fails too.
    if (!(std::abs(norm - 1.0) < 1e-3)) {
      require(false, std::string(name) + ": the quaternion is not of unit length");
    }
    return *this;
  }

  Checker& twist(const msg::Twist* t) {
    return t == nullptr
               ? *this
               : vec(&t->linear(), "twist", kMostOfTwist).vec(&t->angular(), "twist", kMostOfTwist);
  }

  Checker& covariance(const flatbuffers::Vector<double>* c, std::size_t values = 36,
                      std::string_view name = "covariance") {
    if (c == nullptr || c->size() == 0) return *this;
    if (c->size() != values) {
      return require(false, std::string(name) + " has not " + std::to_string(values) + " values");
    }
    for (const double value : *c) within(value, kMostOfNumber, name);
    return *this;
  }

  Checker& numbers(const flatbuffers::Vector<double>* values, std::string_view name) {
    if (values == nullptr) return *this;
    for (const double value : *values) within(value, kMostOfNumber, name);
    return *this;
  }

  Checker& health(msg::Health h) { return require(h <= msg::Health::MAX, "health is unknown"); }

  Checker& finite_points(const flatbuffers::Vector<const msg::Point*>* points,
                         std::string_view name) {
    bool ok = true;
    for (const Point& p : points_of(points)) ok = ok && all_finite(p);
    return ok ? *this : require(false, std::string(name) + ": a point is not finite or too far");
  }

  Checker& finite_points(const flatbuffers::Vector<const msg::MapPoint*>* points,
                         std::string_view name) {
    bool ok = true;
    for (const MapPoint& p : map_points_of(points)) ok = ok && all_finite(p);
    return ok ? *this : require(false, std::string(name) + ": a point is not finite or too far");
  }

  Checker& rings(const flatbuffers::Vector<const msg::Point*>* points, std::uint16_t rings,
                 std::string_view name) {
    bool ok = true;
    for (const Point& p : points_of(points)) ok = ok && (rings == 0 || p.ring < rings);
    return ok ? *this : require(false, std::string(name) + ": a ring is not below rings");
  }

  template <class P, class Q>
  Checker& parallel(const flatbuffers::Vector<P>* points, const flatbuffers::Vector<Q>* values,
                    std::string_view name) {
    const std::size_t n = points == nullptr ? 0 : points->size();
    const std::size_t m = values == nullptr ? 0 : values->size();
    return n == m ? *this : require(false, std::string(name) + ": not as many as points");
  }

  template <class P, class Q>
  Checker& parallel_if_there(const flatbuffers::Vector<P>* points,
                             const flatbuffers::Vector<Q>* values, std::string_view name) {
    return values == nullptr ? *this : parallel(points, values, name);
  }

  Checker& finite_voxels(const flatbuffers::Vector<const msg::MapVoxel*>* voxels) {
    bool ok = true;
    for (const msg::MapVoxel& v : structs_of(voxels)) {
      for (const float value : *v.sum()) ok = ok && std::isfinite(value);
      for (const float value : *v.squares()) ok = ok && std::isfinite(value);
    }
    return ok ? *this : require(false, "a voxel is not finite");
  }

  Checker& imu(const flatbuffers::Vector<const msg::ImuSample*>* samples) {
    for (const msg::ImuSample& s : structs_of(samples)) {
      time(s.stamp_ns(), "imu.stamp_ns");
      vec(&s.linear_acceleration(), "imu", kMostOfReading);
      vec(&s.angular_velocity(), "imu", kMostOfReading);
    }
    return *this;
  }

  std::string take() { return std::move(error_); }

 private:
  template <class P>
  static bool all_finite(const P& p) {
    return std::abs(p.x) <= kMostOfPoint_m && std::abs(p.y) <= kMostOfPoint_m &&
           std::abs(p.z) <= kMostOfPoint_m;
  }
  std::string error_;
};

template <class M>
Checker& weak(Checker& c, const M& m) {
  return c.vec(m.weak_translation(), "weak_translation")
      .vec(m.weak_rotation(), "weak_rotation")
      .finite(m.weak_sigma_measured(), "weak_sigma_measured")
      .finite(m.weak_sigma_predicted(), "weak_sigma_predicted")
      .finite(m.residual_m(), "residual_m");
}

}  // namespace

std::string range_error(const msg::Cloud& m) {
  return Checker()
      .header(m.header())
      .time(m.instant_ns(), "instant_ns")
      .finite_points(m.points(), "points")
      .pose(m.pose_frame_base(), "pose_frame_base")
      .take();
}

std::string range_error(const msg::Command&) { return {}; }
std::string range_error(const msg::CommandReply&) { return {}; }

std::string range_error(const msg::ConfigRevision& m) {
  return Checker()
      .require(m.stage() != nullptr && m.stage()->size() > 0, "stage is missing")
      .require(m.by() != nullptr, "by is missing")
      .require(m.rev() > 0, "rev is 0")
      .require(m.values_json() != nullptr, "values_json is missing")
      .take();
}

std::string range_error(const msg::EffectiveConfig& m) {
  return Checker()
      .require(m.stage() != nullptr && m.instance() != nullptr, "stage or instance is missing")
      .require(m.result_hash() != nullptr, "result_hash is missing")
      .take();
}

std::string range_error(const msg::Features& m) {
  Checker c;
  c.header(m.header()).health(m.health());
  c.finite_points(m.sharp(), "sharp").rings(m.sharp(), m.rings(), "sharp");
  c.finite_points(m.less_sharp(), "less_sharp").rings(m.less_sharp(), m.rings(), "less_sharp");
  c.finite_points(m.flat(), "flat").rings(m.flat(), m.rings(), "flat");
  c.finite_points(m.less_flat(), "less_flat").rings(m.less_flat(), m.rings(), "less_flat");
  c.period(m.period_ns(), points_of(m.less_sharp()).size() + points_of(m.less_flat()).size());
  c.vec(m.removed_rotation(), "removed_rotation").vec(m.removed_shift(), "removed_shift");
  c.imu(m.imu());
  c.require(std::isfinite(m.range_noise_m()) && m.range_noise_m() >= 0.0F,
            "range_noise_m is negative or not finite");
  return c.take();
}

std::string range_error(const msg::FlowAck& m) {
  return Checker()
      .require(m.sink() != nullptr && m.instance() != nullptr, "sink or instance is missing")
      .take();
}

std::string range_error(const msg::GnssBatch& m) {
  Checker c;
  c.header(m.header());
  if (m.fixes() == nullptr) return c.take();
  for (const msg::GnssFix* f : *m.fixes()) {
    // Written so that NaN fails too.
    c.require(std::abs(f->latitude_deg()) <= 90.0, "latitude_deg is beyond +-90")
        .require(std::abs(f->longitude_deg()) <= 180.0, "longitude_deg is beyond +-180");
  }
  return c.take();
}

std::string range_error(const msg::HostTime& m) {
  return Checker()
      .time(m.received_ns(), "received_ns")
      .time(m.sent_ns(), "sent_ns")
      .require(m.sent_ns() >= m.received_ns(), "it was sent before the question came")
      .take();
}

std::string range_error(const msg::GraphPoses& m) {
  Checker c;
  c.header(m.header()).finite(m.chi2_before(), "chi2_before").finite(m.chi2_after(), "chi2_after");
  for (const msg::SubmapPose& p : structs_of(m.poses())) {
    c.time(p.instant_ns(), "poses").pose(p.map(), "poses").pose(p.world(), "poses");
  }
  return c.take();
}

std::string range_error(const msg::ImuBatch& m) {
  return Checker().header(m.header()).imu(m.samples()).take();
}

std::string range_error(const msg::MotorAngles& m) {
  Checker c;
  c.header(m.header());
  for (const msg::AngleReading& r : structs_of(m.readings())) {
    c.time(r.stamp_ns(), "readings").finite(r.angle_rad(), "readings");
  }
  return c.take();
}

std::string range_error(const msg::Loop& m) {
  return Checker()
      .header(m.header())
      .pose(m.pose_from_to(), "pose_from_to")
      .covariance(m.covariance())
      .finite(m.overlap(), "overlap")
      .finite(m.residual_m(), "residual_m")
      .finite(m.chi2(), "chi2")
      .require(m.verdict() <= msg::LoopVerdict::MAX, "verdict is unknown")
      .take();
}

std::string range_error(const msg::MapCorrection& m) {
  Checker c;
  c.header(m.header()).time(m.instant_ns(), "instant_ns");
  c.pose(m.pose_map_odom(), "pose_map_odom").covariance(m.covariance());
  return weak(c, m).health(m.health()).take();
}

std::string range_error(const msg::MapPose& m) {
  return Checker()
      .header(m.header())
      .time(m.instant_ns(), "instant_ns")
      .pose(m.pose_map_base(), "pose_map_base")
      .twist(m.twist())
      .covariance(m.covariance())
      .health(m.health())
      .take();
}

std::string range_error(const msg::MapTile& m) {
  return Checker()
      .header(m.header())
      .require(m.layer() != nullptr && Keys::chunk_error(m.layer()->string_view()).empty(),
               "layer is missing, or no part of a key")
      .require(std::isfinite(m.edge_m()) && m.edge_m() > 0.0, "edge_m is not positive")
      .finite_points(m.points(), "points")
      .parallel_if_there(m.points(), m.counts(), "counts")
      .finite_voxels(m.voxels())
      .require(m.leads() == nullptr || structs_of(m.voxels()).size() == m.leads()->size(),
               "leads: not as many as voxels")
      .take();
}

std::string range_error(const msg::Odometry& m) {
  Checker c;
  c.header(m.header()).time(m.instant_ns(), "instant_ns");
  c.pose(m.pose_odom_base(), "pose_odom_base").twist(m.twist());
  return weak(c.covariance(m.covariance()), m).health(m.health()).take();
}

std::string range_error(const msg::OdometryFeatures& m) {
  Checker c;
  c.header(m.header()).time(m.instant_ns(), "instant_ns");
  c.pose(m.pose_odom_base(), "pose_odom_base").twist(m.twist());
  c.covariance(m.covariance()).pose(m.pose_base_lidar(), "pose_base_lidar");
  c.covariance(m.state_covariance(), 144, "state_covariance");
  c.vec(m.inertial_velocity_change(), "inertial_velocity_change");
  c.vec(m.inertial_turn(), "inertial_turn");
  c.covariance(m.inertial_covariance(), 36, "inertial_covariance");
  c.numbers(m.inertial_state(), "inertial_state");
  c.finite_points(m.edges(), "edges").finite_points(m.planes(), "planes").health(m.health());
  c.period(m.period_ns(), points_of(m.edges()).size() + points_of(m.planes()).size());
  c.require(std::isfinite(m.range_noise_m()) && m.range_noise_m() >= 0.0F,
            "range_noise_m is negative or not finite");
  return c.take();
}

std::string range_error(const msg::Packets& m) {
  Checker c;
  c.header(m.header());
  const std::uint64_t size = m.data() == nullptr ? 0 : m.data()->size();
  for (const msg::PacketEntry& e : structs_of(m.entries())) {
    c.time(e.received_ns(), "received_ns");
    c.require(std::uint64_t{e.offset()} + e.length() <= size, "an entry lies outside of data");
  }
  return c.take();
}

std::string range_error(const msg::Path& m) {
  Checker c;
  c.header(m.header());
  for (const msg::StampedPose& p : structs_of(m.poses())) {
    c.time(p.instant_ns(), "poses").pose(p.pose(), "poses");
  }
  return c.take();
}

std::string range_error(const msg::Preview& m) {
  Checker c;
  c.header(m.header()).time(m.instant_ns(), "instant_ns").health(m.health());
  if (m.pose_map_base() != nullptr) c.pose(*m.pose_map_base(), "pose_map_base");
  c.require(m.block_m() >= 0.0, "block_m is negative").within(m.block_m(), kMost_m, "block_m");
  std::size_t bytes = 0;
  for (const msg::PreviewBlock& block : structs_of(m.blocks())) bytes += block.bytes();
  return c.require(bytes == numbers_of(m.octrees()).size(), "octrees: not as long as blocks say")
      .take();
}

std::string range_error(const msg::Progress& m) {
  return Checker().require(m.instance() != nullptr, "instance is missing").take();
}

std::string range_error(const msg::Rejected& m) {
  Checker c;
  c.header(m.header()).parallel(m.points(), m.reasons(), "reasons");
  if (m.reasons() == nullptr) return c.take();
  for (flatbuffers::uoffset_t i = 0; i < m.reasons()->size(); ++i) {
    c.require(m.reasons()->Get(i) <= msg::RejectReason::MAX, "a reason is unknown");
  }
  return c.take();
}

std::string range_error(const msg::Status& m) {
  return Checker()
      .require(m.stage() != nullptr && m.instance() != nullptr, "stage or instance is missing")
      .require(m.health() <= msg::ServiceHealth::MAX, "health is unknown")
      .finite(m.cpu_ms(), "cpu_ms")
      .take();
}

std::string range_error(const msg::Submap& m) {
  Checker c;
  // The last submap of a run may be empty: it marks the end.
  const std::uint64_t last = m.header() == nullptr ? 0 : m.header()->sweep();
  c.header(m.header())
      .require(m.first_sweep() <= m.frame_sweep() && m.frame_sweep() <= last,
               "frame_sweep lies outside of the submap")
      .time(m.instant_ns(), "instant_ns")
      .pose(m.pose_map_submap(), "pose_map_submap")
      .covariance(m.step_covariance())
      .require(std::isfinite(m.step_m()) && m.step_m() >= 0.0, "step_m is negative or not finite")
      .require(std::isfinite(m.range_noise_m()) && m.range_noise_m() >= 0.0F,
               "range_noise_m is negative or not finite")
      .finite_points(m.points(), "points")
      .parallel_if_there(m.points(), m.hits(), "hits");
  const auto origins = structs_of(m.origins());
  // Each origin has one bit in a point's hits.
  c.require(origins.size() <= 64, "origins are more than 64");
  for (const msg::Vec3& origin : origins) c.vec(&origin, "origins");
  return c.take();
}

std::string range_error(const msg::Sweep& m) {
  Checker c;
  c.header(m.header()).health(m.health()).imu(m.imu());
  c.rings(m.points(), m.rings(), "points").period(m.period_ns(), points_of(m.points()).size());
  if (m.columns() != nullptr && m.columns()->size() > 0) {
    c.parallel(m.points(), m.columns(), "columns");
  }
  c.require(m.return_mode() <= msg::ReturnMode::MAX, "return_mode is unknown");
  c.require(m.clock_source() <= msg::ClockSource::MAX, "clock_source is unknown");
  for (const Point& p : points_of(m.points())) {
    if (p.return_type > ReturnType::kSecondStrongest) c.require(false, "a return type is unknown");
  }
  return c.take();
}

}  // namespace zloam
