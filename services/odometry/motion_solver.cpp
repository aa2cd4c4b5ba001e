#include "odometry/motion_solver.hpp"

#include <Eigen/Cholesky>
#include <utility>

#include "common/geometry/deskew.hpp"
#include "common/geometry/lanes.hpp"

namespace zloam::odometry {
namespace {

Matrix6 small_adjoint(const Vector6& x) {
  Matrix6 ad = Matrix6::Zero();
  const Eigen::Matrix3d w = hat(x.tail<3>());
  ad.topLeftCorner<3, 3>() = w;
  ad.topRightCorner<3, 3>() = hat(x.head<3>());
  ad.bottomRightCorner<3, 3>() = w;
  return ad;
}

// Inverse right Jacobian: Log(Exp(e) Exp(d)) = e + J d. Bernoulli series; e is far below 1.
Matrix6 inverse_right_jacobian(const Vector6& e) {
  const Matrix6 ad = small_adjoint(e);
  const Matrix6 ad2 = ad * ad;
  return Matrix6::Identity() + 0.5 * ad + ad2 / 12.0 - ad2 * ad2 / 720.0 +
         ad2 * ad2 * ad2 / 30240.0;
}

// Collects J J^T and J r of the residuals of one time bin, J = (R^T n, q x R^T n), and folds them
// into the system when the bin changes: dr/dv = J^T s J_left(s v), dr/db = J^T f Ad(M(s))
// J_left(-f b), f = (s^2 - 1/4) / 2.
class Accumulator {
 public:
  Accumulator(const MotionState& state, const MotionTable& table, bool with_bend,
              NormalEquations& equations)
      : rotation_t_(state.T_odom_mid.linear().transpose()),
        left_jacobian_(state.twist),
        of_bend_(state.bend),
        with_bend_(with_bend),
        table_(table),
        equations_(equations) {}

  void start_bin(std::uint16_t bin) {
    if (bin != bin_) {
      fold();
      bin_ = bin;
    }
  }

  void add(const Eigen::Vector3d& moved_point, const Eigen::Vector3d& normal, double residual,
           double weight) {
    const Eigen::Vector3d n = rotation_t_ * normal;
    const Eigen::Vector3d m = moved_point.cross(n);
    const std::array<Double2, 3> j = {Double2{n.x(), n.y()}, Double2{n.z(), m.x()},
                                      Double2{m.y(), m.z()}};
    const std::array<Double2, 3> wj = {weight * j[0], weight * j[1], weight * j[2]};
    for (std::size_t k = 0; k < 3; ++k) {
      gradient_[k] += wj[k] * residual;
      for (std::size_t r = 0; r <= k; ++r) {
        square_[2 * k][r] += wj[r] * j[k][0];
        square_[2 * k + 1][r] += wj[r] * j[k][1];
      }
    }
    filled_ = true;
  }

  void fold() {
    if (!filled_) {
      return;
    }
    const double s = fraction_of_bin(bin_);
    const Matrix6 a = whole_square();
    Vector6 gradient;
    gradient << gradient_[0][0], gradient_[0][1], gradient_[1][0], gradient_[1][1], gradient_[2][0],
        gradient_[2][1];
    const Matrix6 jacobian = s * left_jacobian_.at(s);
    // The lower left block of the Jacobian is zero.
    Matrix6 cross;
    cross.leftCols<3>() = a.leftCols<3>() * jacobian.topLeftCorner<3, 3>();
    cross.rightCols<3>() = a * jacobian.rightCols<3>();
    equations_.H.topLeftCorner<6, 6>() += a;
    equations_.H.topRightCorner<6, 6>() += cross;
    equations_.H.bottomLeftCorner<6, 6>() += cross.transpose();
    equations_.H.bottomRightCorner<6, 6>() += jacobian.transpose() * cross;
    equations_.g.head<6>() += gradient;
    equations_.g.tail<6>() += jacobian.transpose() * gradient;
    if (with_bend_) add_bend(a, jacobian, gradient, s);
    square_ = {};
    gradient_ = {};
    filled_ = false;
  }

 private:
  void add_bend(const Matrix6& a, const Matrix6& jacobian, const Vector6& gradient, double s) {
    const double bent = bent_at(s);
    const Matrix6 of_bend = bent * adjoint(table_[bin_]) * of_bend_.at(-bent);
    const Matrix6 cross = a * of_bend;
    equations_.H_bend.topRows<6>() += cross;
    equations_.H_bend.bottomRows<6>() += jacobian.transpose() * cross;
    equations_.H_bends += of_bend.transpose() * cross;
    equations_.g_bend += of_bend.transpose() * gradient;
  }

  Matrix6 whole_square() const {
    Matrix6 out;
    for (std::size_t c = 0; c < 6; ++c) {
      for (std::size_t r = 0; r <= c; ++r) {
        const auto [i, k] = std::pair(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(c));
        out(i, k) = out(k, i) = square_[c][r / 2][r % 2];
      }
    }
    return out;
  }

  Eigen::Matrix3d rotation_t_;
  LeftJacobian left_jacobian_;
  LeftJacobian of_bend_;
  bool with_bend_;
  const MotionTable& table_;
  NormalEquations& equations_;
  // Columns of J J^T down to the diagonal, two numbers at once, and J r.
  std::array<std::array<Double2, 3>, 6> square_{};
  std::array<Double2, 3> gradient_{};
  std::uint16_t bin_ = 0;
  bool filled_ = false;
};

// Weight times rho'(x); also adds the residual to the sums.
double robust_weight(double squared, double weight, double kernel2, NormalEquations& equations) {
  const double quotient = kernel2 / (kernel2 + squared);
  const double robust = quotient * quotient;
  equations.cost += 0.5 * weight * squared * quotient;
  equations.weight_sum += robust;
  equations.squared_sum += robust * squared;
  return weight * robust;
}

}  // namespace

MotionTable::MotionTable(const MotionState& state)
    : motions_(exp_se3_along(state.twist, fraction_of_bin(0), 1.0 / kTimeBins, kTimeBins + 1)) {
  bend_motions(state.bend, motions_);
}

LeftJacobian::LeftJacobian(const Vector6& twist) {
  // |s| <= 1/2, so a term that has shrunk below this no longer reaches the last digits.
  constexpr double kNegligible = 1e-13;
  const Matrix6 ad = small_adjoint(0.5 * twist);
  Matrix6 term = Matrix6::Identity();
  terms_[0] = term.rightCols<3>();
  while (used_ < kMaxTerms && terms_[used_ - 1].cwiseAbs().maxCoeff() > kNegligible) {
    term = (term * ad / (static_cast<double>(used_) + 1.0)).eval();
    terms_[used_] = term.rightCols<3>();
    ++used_;
  }
}

Matrix6 LeftJacobian::at(double s) const {
  RightHalf sum = terms_[used_ - 1];
  for (std::size_t n = used_ - 1; n-- > 0;) {
    sum = terms_[n] + (2.0 * s) * sum;
  }
  Matrix6 out;
  out << sum.bottomRows<3>(), sum.topRows<3>(), Eigen::Matrix3d::Zero(), sum.bottomRows<3>();
  return out;
}

void add_residuals(const MotionState& state, const MotionTable& table, const Residuals& residuals,
                   double kernel_m, bool with_bend, NormalEquations& equations) {
  const double kernel2 = kernel_m * kernel_m;
  Accumulator accumulator(state, table, with_bend, equations);
  for (const PlaneResidual& p : residuals.planes) {
    const Eigen::Vector3d q = table[p.bin] * p.point;
    const double r = p.normal.dot(state.T_odom_mid * q) - p.offset;
    accumulator.start_bin(p.bin);
    accumulator.add(q, p.normal, r, robust_weight(r * r, p.weight, kernel2, equations));
  }
  accumulator.fold();
}

Matrix12 independent(const Vector6& begin_sigma, const Vector6& twist_sigma) {
  Vector12 sigma;
  sigma << begin_sigma, twist_sigma;
  return Vector12(sigma.array().square().inverse()).asDiagonal();
}

std::optional<Matrix12> information_of(const Matrix12& covariance) {
  const Eigen::LDLT<Matrix12> ldlt(covariance);
  if (!covariance.allFinite() || !(ldlt.vectorD().minCoeff() > 0.0)) return std::nullopt;
  const Matrix12 inverse = ldlt.solve(Matrix12::Identity());
  return 0.5 * (inverse + inverse.transpose());
}

void add_prior(const MotionState& state, const MotionPrior& prior, NormalEquations& equations) {
  const Pose to_begin = exp_se3(-0.5 * state.twist);
  Vector12 e;
  e << log_se3(prior.T_odom_begin.inverse() * state.T_odom_mid * to_begin),
      state.twist - prior.twist;
  const Matrix6 inverse = inverse_right_jacobian(e.head<6>());
  Matrix12 jacobian = Matrix12::Identity();
  jacobian.topLeftCorner<6, 6>() = inverse * adjoint(to_begin.inverse());
  // T Exp(-(v + dv) / 2) = T Exp(-v / 2) Exp(-J_left(v / 2) dv / 2)
  jacobian.topRightCorner<6, 6>() = -0.5 * inverse * LeftJacobian(state.twist).at(0.5);
  const Matrix12 weighed = jacobian.transpose() * prior.information;
  equations.H += weighed * jacobian;
  equations.g += weighed * e;
  equations.cost += 0.5 * e.dot(prior.information * e);
}

EliminatedBend::EliminatedBend(const MotionState& state, const MotionPrior& prior,
                               NormalEquations& equations) {
  if (!(prior.bend_sigma.minCoeff() > 0.0)) return;
  const Vector6 information = prior.bend_sigma.array().square().inverse();
  const Vector6 off = state.bend - prior.bend;
  Matrix6 h = equations.H_bends;
  h.diagonal() += information;
  const Eigen::LDLT<Matrix6> ldlt(h);
  own_ = -ldlt.solve(equations.g_bend + information.cwiseProduct(off));
  by_others_ = ldlt.solve(equations.H_bend.transpose());
  equations.H -= equations.H_bend * by_others_;
  equations.g += equations.H_bend * own_;
  equations.cost += 0.5 * off.dot(information.cwiseProduct(off));
}

Vector12 solve_step(const NormalEquations& equations) {
  return -equations.H.ldlt().solve(equations.g);
}

MotionState moved(const MotionState& state, const Vector12& step) {
  MotionState next = state;
  next.T_odom_mid = state.T_odom_mid * exp_se3(step.head<6>());
  next.twist += step.tail<6>();
  return next;
}

void hold_still(const Vector6& sigma, MotionState& state, Matrix12& covariance) {
  const Eigen::Matrix<double, 12, 6> of_twist = covariance.rightCols<6>();
  Matrix6 sum = covariance.bottomRightCorner<6, 6>();
  sum.diagonal() += sigma.array().square().matrix();
  const Eigen::Matrix<double, 12, 6> gain = sum.ldlt().solve(of_twist.transpose()).transpose();
  state = moved(state, -gain * state.twist);
  const Matrix12 left = covariance - gain * of_twist.transpose();
  covariance = 0.5 * (left + left.transpose());
}

Matrix12 motion_jacobian(const MotionState& state, double s) {
  Matrix12 jacobian = Matrix12::Identity();
  jacobian.topLeftCorner<6, 6>() = adjoint(exp_se3(s * state.twist).inverse());
  jacobian.topRightCorner<6, 6>() = s * LeftJacobian(state.twist).at(-s);
  return jacobian;
}

Matrix12 end_covariance(const MotionState& state, const Matrix12& covariance) {
  const Matrix12 jacobian = motion_jacobian(state, 0.5);
  return jacobian * covariance * jacobian.transpose();
}

}  // namespace zloam::odometry
