#include "odometry/knot_window.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

namespace zloam::odometry {
namespace {

constexpr double kGateWidths = 3.0;
// Each slice's solution starts from the last one, so the kernel need not start wide.
constexpr double kStartWidths = 2.0;
constexpr int kMostIterations = 12;
// Initial velocity, one sigma about rest, m/s and rad/s: a platform mostly starts at rest, and the
// points of one revolution outweigh this.
constexpr double kStartSigma = 0.05;

using Row6 = Eigen::Matrix<double, 1, 6>;

Vector6 acceleration_sigmas(const OdometryConfig& config) {
  Vector6 s;
  s << Eigen::Vector3d::Constant(config.slice_acceleration_sigma_mps2),
      Eigen::Vector3d::Constant(config.slice_angular_acceleration_sigma_radps2);
  return s;
}

}  // namespace

/// H x = -g over the free knots (1 ... n), gravity and the gyroscope's bias.
struct KnotWindow::System {
  explicit System(std::size_t knots) : n(knots), H(size(), size()), g(size()) {
    H.setZero();
    g.setZero();
  }
  Eigen::Index size() const { return static_cast<Eigen::Index>(6 * (n - 1) + 6); }
  /// Index of a knot's first unknown; below 0: the knot is fixed.
  static Eigen::Index at(std::size_t knot) { return 6 * static_cast<Eigen::Index>(knot) - 6; }
  /// Index of the IMU's unknowns: gravity, then the gyroscope's bias.
  Eigen::Index inertia() const { return size() - 6; }

  template <int Rows>
  struct Part {
    Eigen::Index at;
    Eigen::Matrix<double, Rows, 6> J;
  };
  template <int Rows, std::size_t Parts>
  void add(const Eigen::Matrix<double, Rows, 1>& e, const Eigen::Matrix<double, Rows, 1>& weight,
           const std::array<Part<Rows>, Parts>& parts) {
    for (const auto& a : parts) {
      if (a.at < 0) continue;
      const Eigen::Matrix<double, 6, Rows> Jw = a.J.transpose() * weight.asDiagonal();
      g.segment<6>(a.at) += Jw * e;
      for (const auto& b : parts) {
        if (b.at < 0) continue;
        H.block<6, 6>(a.at, b.at) += Jw * b.J;
      }
    }
  }

  std::size_t n;
  Eigen::MatrixXd H;
  Eigen::VectorXd g;
};

struct KnotWindow::Match {
  Row6 J;  ///< of the pose at the point's own time
  double r;
  double part;
  std::size_t slice;
  Eigen::Vector3d normal, position;  ///< frame odom
};

/// Covariance of the last knot relative to the one before it, their correlation included.
Matrix6 KnotWindow::last_step_covariance(const System& system,
                                         const Eigen::LDLT<Eigen::MatrixXd>& ldlt) const {
  const Eigen::Index at = System::at(knots_.size() - 1);
  Eigen::MatrixXd step = Eigen::MatrixXd::Zero(system.size(), 6);
  step.middleRows<6>(at) = Matrix6::Identity();
  if (at >= 6) step.middleRows<6>(at - 6) = -Matrix6::Identity();
  return step.transpose() * ldlt.solve(step);
}

void KnotWindow::begin(const Pose& T_odom_base) {
  knots_ = {T_odom_base};
  slices_.clear();
  velocity_before_.setZero();
  velocity_before_sigma_.setConstant(kStartSigma);
  inertia_before_.reset();
}

Vector6 KnotWindow::velocity(std::size_t k) const {
  return log_se3(knots_[k].inverse() * knots_[k + 1]) / slices_[k].period_s;
}

void KnotWindow::push(Slice slice) {
  const Vector6 v = slices_.empty() ? velocity_before_ : velocity(slices_.size() - 1);
  const double before_s = slices_.empty() ? period_before_s_ : slices_.back().period_s;
  const auto& inertia_before = slices_.empty() ? inertia_before_ : slices_.back().inertia;
  Pose next = knots_.back() * exp_se3(slice.period_s * v);
  if (slice.inertia && inertia_before && knows_gravity()) {
    const Eigen::Matrix3d& R = knots_.back().linear();
    const Eigen::Vector3d w = inertia_before->mean_to_end_mps + slice.inertia->begin_to_mean_mps;
    const std::size_t n = knots_.size();
    const Eigen::Vector3d moved =
        n > 1 ? Eigen::Vector3d(knots_[n - 1].translation() - knots_[n - 2].translation())
              : Eigen::Vector3d(R * v.head<3>() * before_s);
    const Eigen::Vector3d u =
        moved / before_s + R * w + 0.5 * (before_s + slice.period_s) * inertia_.gravity_mps2;
    next.translation() = knots_.back().translation() + slice.period_s * u;
    next.linear() = R * exp_so3(slice.inertia->turn_rad);
  }
  slices_.push_back(std::move(slice));
  knots_.push_back(normalised(next));
}

KnotWindow KnotWindow::without_inertia() const {
  KnotWindow alone = *this;
  for (Slice& slice : alone.slices_) slice.inertia.reset();
  alone.inertia_before_.reset();
  return alone;
}

void KnotWindow::pop() {
  velocity_before_ = velocity(0);
  velocity_before_sigma_.setZero();
  period_before_s_ = slices_.front().period_s;
  inertia_before_ = slices_.front().inertia;
  slices_.pop_front();
  knots_.pop_front();
}

std::vector<KnotWindow::Match> KnotWindow::match(WindowMap& target, double gate_m) const {
  std::vector<Eigen::Vector3d> positions;
  std::vector<Eigen::Matrix3d> rotations;
  std::vector<Match> matches;
  for (std::size_t k = 0; k < slices_.size(); ++k) {
    const Vector6 twist = log_se3(knots_[k].inverse() * knots_[k + 1]);
    for (const SlicePoint& p : slices_[k].points) {
      const Pose T = knots_[k] * exp_se3(p.part * twist);
      positions.push_back(T * p.position);
      rotations.emplace_back(T.linear());
      Match m{};
      m.part = p.part;
      m.slice = k;
      m.position = p.position;
      matches.push_back(m);
    }
  }
  std::vector<WindowMap::Hint> hints(positions.size());
  target.find(positions, hints, 1);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const FittedPlane* plane = hints[i].plane;
    if (plane == nullptr) continue;
    Match m = matches[i];
    m.r = plane->normal.dot(positions[i]) - plane->offset;
    if (std::abs(m.r) >= gate_m) continue;
    const Eigen::Vector3d n_base = rotations[i].transpose() * plane->normal;
    m.J.head<3>() = n_base.transpose();
    m.J.tail<3>() = m.position.cross(n_base).transpose();
    m.normal = plane->normal;
    m.position = positions[i];
    matches[kept++] = m;
  }
  matches.resize(kept);
  return matches;
}

void KnotWindow::add_points(const std::vector<Match>& matches, double weight, double kernel_m,
                            System& system, NormalEquations& data) const {
  const double k2 = kernel_m * kernel_m;
  const Pose T_base_odom = knots_.back().inverse();
  for (const Match& m : matches) {
    const double shape = k2 / (k2 + m.r * m.r);
    const double robust = shape * shape;
    const Eigen::Matrix<double, 1, 1> e(m.r), w(weight * robust);
    const std::array<System::Part<1>, 2> parts = {
        System::Part<1>{System::at(m.slice), (1.0 - m.part) * m.J},
        System::Part<1>{System::at(m.slice + 1), m.part * m.J}};
    system.add<1, 2>(e, w, parts);
    const Eigen::Vector3d n_base = T_base_odom.linear() * m.normal;
    Row6 rigid;
    rigid << n_base.transpose(), (T_base_odom * m.position).cross(n_base).transpose();
    data.H.topLeftCorner<6, 6>() += w[0] * rigid.transpose() * rigid;
    data.weight_sum += robust;
    data.squared_sum += robust * m.r * m.r;
  }
}

/// Robustly weighted share of points on surfaces among the newer half of the slices: over the whole
/// window a recent change would show too slowly.
double KnotWindow::explained_of_newest(const std::vector<Match>& matches, double kernel_m) const {
  const double k2 = kernel_m * kernel_m;
  const std::size_t first = slices_.size() / 2;
  std::size_t points = 0;
  for (std::size_t k = first; k < slices_.size(); ++k) points += slices_[k].points.size();
  double on_surface = 0.0;
  for (const Match& m : matches) {
    if (m.slice >= first) on_surface += k2 / (k2 + m.r * m.r);
  }
  return on_surface / static_cast<double>(std::max<std::size_t>(1, points));
}

/// Adds the smoothness between slice k - 1 (or the one that left the window) and slice k.
void KnotWindow::add_smoothness(std::size_t k, System& system) const {
  const double before_s = k == 0 ? period_before_s_ : slices_[k - 1].period_s;
  const double after_s = slices_[k].period_s;
  const Vector6 e = velocity(k) - (k == 0 ? velocity_before_ : velocity(k - 1));
  const Vector6 sigma = 0.5 * (before_s + after_s) * acceleration_sigmas(config_);
  Vector6 variance = sigma.array().square();
  if (k == 0) variance.array() += velocity_before_sigma_.array().square();
  Vector6 weight = variance.cwiseInverse();
  // Where the IMU measures the motion, its terms replace the smoothness.
  const bool felt = slices_[k].inertia.has_value();
  const bool felt_before =
      k == 0 ? inertia_before_.has_value() : slices_[k - 1].inertia.has_value();
  if (felt) weight.tail<3>().setZero();
  if (felt && felt_before && knows_gravity()) weight.head<3>().setZero();
  const std::array<System::Part<6>, 3> parts = {
      System::Part<6>{k == 0 ? -1 : System::at(k - 1), Matrix6::Identity() / before_s},
      System::Part<6>{System::at(k), -Matrix6::Identity() * (1.0 / before_s + 1.0 / after_s)},
      System::Part<6>{System::at(k + 1), Matrix6::Identity() / after_s}};
  system.add<6, 3>(e, weight, parts);
}

void KnotWindow::add_turn(std::size_t k, System& system) const {
  const Slice& slice = slices_[k];
  if (!slice.inertia) return;
  const Eigen::Vector3d& turn = slice.inertia->turn_rad;
  const Eigen::Vector3d off_radps = inertia_.rate_bias_radps - slice.rate_bias_radps;
  const Eigen::Matrix3d R = knots_[k].linear().transpose() * knots_[k + 1].linear();
  const Eigen::Vector3d e = log_so3(exp_so3(turn).transpose() * R) + slice.period_s * off_radps;
  const double noise = config_.imu_rate_noise;
  const double scale = config_.imu_scale_error * turn.norm();
  const double variance = noise * noise * slice.period_s + scale * scale;
  const Eigen::Vector3d weight = Eigen::Vector3d::Constant(1.0 / variance);
  Eigen::Matrix<double, 3, 6> J = Eigen::Matrix<double, 3, 6>::Zero();
  J.rightCols<3>() = -R.transpose();
  Eigen::Matrix<double, 3, 6> J_after = Eigen::Matrix<double, 3, 6>::Zero();
  J_after.rightCols<3>() = Eigen::Matrix3d::Identity();
  const Eigen::Matrix<double, 3, 6> J_bias = slice.period_s * J_after;
  const std::array<System::Part<3>, 3> parts = {System::Part<3>{System::at(k), J},
                                                System::Part<3>{System::at(k + 1), J_after},
                                                System::Part<3>{system.inertia(), J_bias}};
  system.add<3, 3>(e, weight, parts);
}

/// The mean velocities of slices k and k + 1 differ by the effect of force and gravity between
/// their middles.
void KnotWindow::add_force(std::size_t k, System& system) const {
  const Slice& before = slices_[k];
  const Slice& after = slices_[k + 1];
  if (!before.inertia || !after.inertia || !knows_gravity()) return;
  const auto p = [&](std::size_t i) -> const Eigen::Vector3d { return knots_[i].translation(); };
  const Eigen::Matrix3d& R = knots_[k + 1].linear();
  const Eigen::Vector3d w = before.inertia->mean_to_end_mps + after.inertia->begin_to_mean_mps;
  const double apart_s = 0.5 * (before.period_s + after.period_s);
  const Eigen::Vector3d e = (p(k + 2) - p(k + 1)) / after.period_s -
                            (p(k + 1) - p(k)) / before.period_s - R * w -
                            apart_s * inertia_.gravity_mps2;
  const double sigma = config_.slice_force_sigma_mps2 * apart_s;
  const Eigen::Vector3d weight = Eigen::Vector3d::Constant(1.0 / (sigma * sigma));
  Eigen::Matrix<double, 3, 6> J0 = Eigen::Matrix<double, 3, 6>::Zero();
  Eigen::Matrix<double, 3, 6> J1 = J0, J2 = J0, J_gravity = J0;
  J0.leftCols<3>() = knots_[k].linear() / before.period_s;
  J1.leftCols<3>() = -R * (1.0 / before.period_s + 1.0 / after.period_s);
  J1.rightCols<3>() = R * hat(w);
  J_gravity.leftCols<3>() = -apart_s * Eigen::Matrix3d::Identity();
  J2.leftCols<3>() = knots_[k + 2].linear() / after.period_s;
  const std::array<System::Part<3>, 4> parts = {
      System::Part<3>{System::at(k), J0}, System::Part<3>{System::at(k + 1), J1},
      System::Part<3>{System::at(k + 2), J2}, System::Part<3>{system.inertia(), J_gravity}};
  system.add<3, 4>(e, weight, parts);
}

void KnotWindow::add_motion(const KnotInertia& before, System& system) const {
  for (std::size_t k = 0; k < slices_.size(); ++k) {
    add_smoothness(k, system);
    add_turn(k, system);
    if (k + 1 < slices_.size()) add_force(k, system);
  }
  const auto hold = [&system](Eigen::Index at, const Eigen::Vector3d& moved, double sigma) {
    const double information = 1.0 / (sigma * sigma);
    system.H.diagonal().segment<3>(at).array() += information;
    system.g.segment<3>(at) += information * moved;
  };
  hold(system.inertia(), inertia_.gravity_mps2 - before.gravity_mps2, before.gravity_sigma_mps2);
  hold(system.inertia() + 3, inertia_.rate_bias_radps - before.rate_bias_radps,
       before.rate_bias_sigma_radps);
}

void KnotWindow::move(const Eigen::VectorXd& step) {
  for (std::size_t k = 1; k < knots_.size(); ++k) {
    knots_[k] = normalised(knots_[k] * exp_se3(step.segment<6>(System::at(k))));
  }
  const Eigen::Index size = step.size();
  inertia_.gravity_mps2 += step.segment<3>(size - 6);
  inertia_.rate_bias_radps += step.segment<3>(size - 3);
}

KnotSolution KnotWindow::solve(WindowMap& target, double range_noise_m) {
  KnotSolution out;
  const std::deque<Pose> initial = knots_;
  const KnotInertia initial_inertia = inertia_;
  const double noise_m = std::max(1e-3, range_noise_m);
  const double weight = 1.0 / (noise_m * noise_m * std::max(1.0, config_.correlation));
  double kernel_m = kStartWidths * config_.kernel_m;
  for (int i = 0; i < kMostIterations; ++i) {
    const std::vector<Match> matches = match(target, kGateWidths * kernel_m);
    out.matched = static_cast<std::uint32_t>(matches.size());
    out.solved = out.matched >= static_cast<std::uint32_t>(config_.min_correspondences);
    if (!out.solved) break;
    System system(knots_.size());
    out.data = {};
    add_points(matches, weight, kernel_m, system, out.data);
    add_motion(initial_inertia, system);
    const Eigen::LDLT<Eigen::MatrixXd> ldlt(system.H);
    const Eigen::VectorXd step = ldlt.solve(-system.g);
    out.solved = step.allFinite();
    if (!out.solved) break;
    move(step);
    out.iterations = static_cast<std::uint32_t>(i + 1);
    out.explained = explained_of_newest(matches, kernel_m);
    const auto last = step.segment<6>(System::at(knots_.size() - 1));
    if (kernel_m <= config_.kernel_m && last.head<3>().norm() < config_.stop_translation_m &&
        last.tail<3>().norm() < config_.stop_rotation_rad * 5.0) {
      out.converged = true;
    }
    if (out.converged || i + 1 == kMostIterations) {
      out.covariance = last_step_covariance(system, ldlt);
      break;
    }
    kernel_m = std::max(config_.kernel_m, 0.5 * kernel_m);
  }
  out.residual_m = std::sqrt(out.data.squared_sum / std::max(1e-9, out.data.weight_sum));
  if (!out.solved || !knots_.back().matrix().allFinite()) {
    knots_ = initial;
    inertia_ = initial_inertia;
    out.explained = 0.0;
    out.converged = false;
    out.solved = false;
  }
  return out;
}

}  // namespace zloam::odometry
