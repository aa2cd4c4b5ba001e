#include "odometry/motion_solver.hpp"

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace zloam::odometry {
namespace {

// The cost of the header's formulas with automatic derivatives, independent of the solver's code:
// exponential by its power series, logarithm by Ceres' rotation functions and the series of V.
template <typename T>
using Vec3 = Eigen::Matrix<T, 3, 1>;
template <typename T>
using Mat3 = Eigen::Matrix<T, 3, 3>;

template <typename T>
Mat3<T> skew(const Vec3<T>& a) {
  Mat3<T> m;
  m << T(0), -a.z(), a.y(), a.z(), T(0), -a.x(), -a.y(), a.x(), T(0);
  return m;
}

// Power series: exact to the last digit for the angles of the tests, and differentiable at zero.
template <typename T>
void exponential(const Vec3<T>& rho, const Vec3<T>& theta, Mat3<T>& R, Vec3<T>& t) {
  const Mat3<T> w = skew(theta);
  Mat3<T> term = Mat3<T>::Identity();
  Mat3<T> V = Mat3<T>::Zero();
  R = Mat3<T>::Zero();
  for (int n = 0; n < 25; ++n) {
    R += term;
    V += term / T(n + 1.0);
    term = Mat3<T>(term * w) / T(n + 1.0);
  }
  t = V * rho;
}

struct Problem {
  MotionState start;
  MotionPrior prior;
  Residuals residuals;
  double kernel_m = 0.1;
};

using Vector18 = Eigen::Matrix<double, 18, 1>;
using Matrix18 = Eigen::Matrix<double, 18, 18>;

// x: perturbation of T (right), the twist and the bend themselves.
template <typename T>
Vec3<T> moved_point(const Problem& problem, const T* x, const Eigen::Vector3d& point, int bin) {
  const T s(fraction_of_bin(bin));
  Mat3<T> R;
  Vec3<T> t;
  exponential<T>(Vec3<T>(s * x[6], s * x[7], s * x[8]), Vec3<T>(s * x[9], s * x[10], s * x[11]), R,
                 t);
  const T f = T(0.5) * (s * s - T(0.25));
  Mat3<T> bent;
  Vec3<T> shifted;
  exponential<T>(Vec3<T>(f * x[12], f * x[13], f * x[14]), Vec3<T>(f * x[15], f * x[16], f * x[17]),
                 bent, shifted);
  const Vec3<T> q = R * (bent * point.cast<T>() + shifted) + t;
  exponential<T>(Vec3<T>(x[0], x[1], x[2]), Vec3<T>(x[3], x[4], x[5]), R, t);
  const Vec3<T> local = R * q + t;
  return problem.start.T_odom_mid.linear().cast<T>() * local +
         problem.start.T_odom_mid.translation().cast<T>();
}

struct PlaneCost {
  const Problem* problem;
  PlaneResidual r;
  template <typename T>
  bool operator()(const T* x, T* out) const {
    const Vec3<T> w = moved_point(*problem, x, r.point, r.bin);
    out[0] = T(std::sqrt(r.weight)) * (r.normal.cast<T>().dot(w) - T(r.offset));
    return true;
  }
};

// The logarithm is taken from the difference of two nearby poses: its series needs only small
// angles, so R = I + w + ... is inverted by the axis-angle closed form of Ceres.
struct PriorCost {
  const Problem* problem;
  template <typename T>
  bool operator()(const T* x, T* out) const {
    Mat3<T> Rh, Rx;
    Vec3<T> th, tx;
    const T h(-0.5);
    exponential<T>(Vec3<T>(h * x[6], h * x[7], h * x[8]), Vec3<T>(h * x[9], h * x[10], h * x[11]),
                   Rh, th);
    exponential<T>(Vec3<T>(x[0], x[1], x[2]), Vec3<T>(x[3], x[4], x[5]), Rx, tx);
    const Pose D = problem->prior.T_odom_begin.inverse() * problem->start.T_odom_mid;
    const Mat3<T> R = D.linear().cast<T>() * Rx * Rh;
    const Vec3<T> t = D.linear().cast<T>() * (Rx * th + tx) + D.translation().cast<T>();
    T aa[3];
    ceres::RotationMatrixToAngleAxis(R.data(), aa);
    const Vec3<T> theta(aa[0], aa[1], aa[2]);
    // V by its series, then rho = V^-1 t.
    const Mat3<T> w = skew(theta);
    Mat3<T> term = Mat3<T>::Identity();
    Mat3<T> V = Mat3<T>::Zero();
    for (int n = 0; n < 25; ++n) {
      V += term / T(n + 1.0);
      term = Mat3<T>(term * w) / T(n + 1.0);
    }
    const Vec3<T> rho = V.inverse() * t;
    Eigen::Matrix<T, 12, 1> e;
    e << rho, theta,
        Eigen::Map<const Eigen::Matrix<T, 6, 1>>(x + 6) - problem->prior.twist.cast<T>();
    const Matrix12 root = problem->prior.information.llt().matrixU();
    Eigen::Map<Eigen::Matrix<T, 12, 1>>{out} = root.cast<T>() * e;
    return true;
  }
};

struct BendCost {
  const Problem* problem;
  template <typename T>
  bool operator()(const T* x, T* out) const {
    for (int i = 0; i < 6; ++i) {
      out[i] = (x[12 + i] - T(problem->prior.bend[i])) / T(problem->prior.bend_sigma[i]);
    }
    return true;
  }
};

// rho(x) = k^2 x / (k^2 + x) with x in units of the weight.
class GemanMcClure : public ceres::LossFunction {
 public:
  explicit GemanMcClure(double kernel2) : k2_(kernel2) {}
  void Evaluate(double s, double out[3]) const override {
    const double q = k2_ / (k2_ + s);
    out[0] = s * q;
    out[1] = q * q;
    out[2] = -2.0 * q * q / (k2_ + s);
  }

 private:
  double k2_;
};

// Points on random planes, seen with a true motion and noise, with some outliers.
Problem random_problem(unsigned seed, double rate) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  std::normal_distribution<double> g(0.0, 0.01);
  const auto random3 = [&](double scale) {
    return Eigen::Vector3d(scale * u(rng), scale * u(rng), scale * u(rng));
  };
  Vector6 twist;
  twist << random3(0.3), random3(rate);
  Vector6 pose;
  pose << random3(5.0), random3(1.0);
  MotionState truth{exp_se3(pose), twist};
  truth.bend << random3(0.1), random3(0.2);
  const MotionTable motions(truth);
  Problem p;
  for (int i = 0; i < 300; ++i) {
    const int bin = static_cast<int>((u(rng) + 1.0) * 0.5 * kTimeBins);
    const Eigen::Vector3d point = random3(10.0);
    const Eigen::Vector3d w = truth.T_odom_mid * (motions[static_cast<std::size_t>(bin)] * point);
    const double error = g(rng) + (i % 20 == 0 ? 0.2 : 0.0);
    const Eigen::Vector3d n = random3(1.0).normalized();
    p.residuals.planes.push_back({point, n, n.dot(w) + error, 250.0, std::uint16_t(bin)});
  }
  Vector6 offset;
  offset << random3(0.02), random3(0.01);
  p.start = truth;
  p.start.T_odom_mid = truth.T_odom_mid * exp_se3(offset);
  p.start.twist = truth.twist + 0.5 * offset;
  p.prior.T_odom_begin = truth.T_odom_begin() * exp_se3(0.1 * offset);
  p.prior.begin_sigma << 0.003, 0.003, 0.003, 0.002, 0.002, 0.002;
  p.prior.twist = truth.twist + 0.3 * offset;
  p.prior.twist_sigma << 0.03, 0.03, 0.03, 0.02, 0.02, 0.02;
  p.start.bend = truth.bend + offset;
  p.prior.bend = truth.bend - offset;
  p.prior.bend_sigma << 0.02, 0.03, 0.02, 0.03, 0.02, 0.03;
  // Begin and twist are correlated, as after a sweep.
  Matrix12 hang_together = Matrix12::Identity();
  hang_together.topRightCorner<6, 6>() =
      0.3 * Matrix6::NullaryExpr([&](auto, auto) { return u(rng); });
  p.prior.information = hang_together.transpose() *
                        independent(p.prior.begin_sigma, p.prior.twist_sigma) * hang_together;
  return p;
}

struct CeresProblem {
  explicit CeresProblem(const Problem& p, bool robust) {
    x.setZero();
    x.segment<6>(6) = p.start.twist;
    x.tail<6>() = p.start.bend;
    for (const PlaneResidual& r : p.residuals.planes) {
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<PlaneCost, 1, 18>(new PlaneCost{&p, r}),
          robust ? new GemanMcClure(p.kernel_m * p.kernel_m * r.weight) : nullptr, x.data());
    }
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<PriorCost, 12, 18>(new PriorCost{&p}),
                             nullptr, x.data());
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<BendCost, 6, 18>(new BendCost{&p}),
                             nullptr, x.data());
  }
  Vector18 x;
  ceres::Problem problem;
};

// The whole system, the bend and its prior included.
struct Whole {
  explicit Whole(const NormalEquations& sums, const Problem& p) {
    const Vector6 information = p.prior.bend_sigma.array().square().inverse();
    const Vector6 off = p.start.bend - p.prior.bend;
    H << sums.H, sums.H_bend, sums.H_bend.transpose(), sums.H_bends;
    H.bottomRightCorner<6, 6>().diagonal() += information;
    g << sums.g, sums.g_bend + information.cwiseProduct(off);
    cost = sums.cost + 0.5 * off.dot(information.cwiseProduct(off));
  }
  Matrix18 H;
  Vector18 g;
  double cost;
};

TEST(MotionSolver, GradientAndCostMatchAutomaticDerivatives) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    const Problem p = random_problem(seed, 0.3);
    NormalEquations own;
    add_residuals(p.start, MotionTable(p.start), p.residuals, p.kernel_m, true, own);
    add_prior(p.start, p.prior, own);
    const Whole whole(own, p);
    CeresProblem other(p, true);
    double cost = 0.0;
    std::vector<double> gradient;
    other.problem.Evaluate({}, &cost, nullptr, &gradient, nullptr);
    EXPECT_NEAR(whole.cost, cost, 1e-9 * cost);
    const Eigen::Map<const Vector18> g(gradient.data());
    EXPECT_LT((whole.g - g).norm(), 1e-8 * g.norm()) << seed;
  }
}

TEST(MotionSolver, GaussNewtonMatrixMatchesAutomaticDerivatives) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    Problem p = random_problem(seed, 0.3);
    NormalEquations own;
    // A kernel beyond all residuals: the matrix is J^T J.
    add_residuals(p.start, MotionTable(p.start), p.residuals, 1e6, true, own);
    add_prior(p.start, p.prior, own);
    CeresProblem other(p, false);
    ceres::CRSMatrix crs;
    other.problem.Evaluate({}, nullptr, nullptr, nullptr, &crs);
    Eigen::MatrixXd jacobian = Eigen::MatrixXd::Zero(crs.num_rows, crs.num_cols);
    for (int row = 0; row < crs.num_rows; ++row) {
      for (int k = crs.rows[std::size_t(row)]; k < crs.rows[std::size_t(row) + 1]; ++k) {
        jacobian(row, crs.cols[std::size_t(k)]) = crs.values[std::size_t(k)];
      }
    }
    const Matrix18 H = jacobian.transpose() * jacobian;
    EXPECT_LT((Whole(own, p).H - H).norm(), 1e-8 * H.norm()) << seed;
    // Eliminating the bend leaves the inverse of the other unknowns' block of the covariance.
    EliminatedBend(p.start, p.prior, own);
    const Matrix12 covariance = Matrix18(H.inverse()).topLeftCorner<12, 12>();
    EXPECT_LT((own.H.inverse() - covariance).norm(), 1e-6 * covariance.norm()) << seed;
  }
}

TEST(MotionSolver, ConvergesToTheSameMotionAsCeres) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    const Problem p = random_problem(seed, 0.3);
    MotionState own = p.start;
    for (int i = 0; i < 200; ++i) {
      NormalEquations equations;
      add_residuals(own, MotionTable(own), p.residuals, p.kernel_m, true, equations);
      add_prior(own, p.prior, equations);
      const EliminatedBend bend(own, p.prior, equations);
      const Vector12 step = solve_step(equations);
      own = moved(own, step);
      own.bend += bend.step(step);
    }
    CeresProblem other(p, true);
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.max_num_iterations = 500;
    options.function_tolerance = 1e-18;
    options.gradient_tolerance = 1e-14;
    options.parameter_tolerance = 1e-14;
    options.num_threads = 1;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &other.problem, &summary);
    const Pose T = p.start.T_odom_mid * exp_se3(other.x.head<6>());
    EXPECT_LT(log_se3(T.inverse() * own.T_odom_mid).norm(), 1e-9) << summary.BriefReport();
    EXPECT_LT((own.twist - other.x.segment<6>(6)).norm(), 1e-9);
    EXPECT_LT((own.bend - other.x.tail<6>()).norm(), 1e-8);
  }
}

TEST(MotionSolver, LeftJacobianMatchesDifferences) {
  Vector6 v;
  v << 1.5, -0.4, 0.3, 0.9, -1.2, 1.7;
  const LeftJacobian jacobian(v);
  for (double s : {-0.5, -0.1, 0.0, 0.3, 0.5}) {
    Matrix6 numeric;
    for (int i = 0; i < 6; ++i) {
      const double h = 1e-6;
      const Vector6 d = Vector6::Unit(i) * h;
      const Pose plus = exp_se3(s * v + d) * exp_se3(s * v).inverse();
      const Pose minus = exp_se3(s * v - d) * exp_se3(s * v).inverse();
      numeric.col(i) = (log_se3(plus) - log_se3(minus)) / (2.0 * h);
    }
    EXPECT_LT((jacobian.at(s) - numeric).norm(), 1e-8) << s;
  }
}

TEST(MotionSolver, EndCovarianceMatchesSampling) {
  const Problem p = random_problem(3, 0.3);
  NormalEquations equations;
  add_residuals(p.start, MotionTable(p.start), p.residuals, p.kernel_m, false, equations);
  add_prior(p.start, p.prior, equations);
  const Matrix12 covariance = equations.H.inverse();
  const Eigen::LLT<Matrix12> root(covariance);
  std::mt19937 rng(9);
  std::normal_distribution<double> g(0.0, 1.0);
  Matrix12 sampled = Matrix12::Zero();
  const int samples = 20000;
  for (int i = 0; i < samples; ++i) {
    const Vector12 x = root.matrixL() * Vector12::NullaryExpr([&](auto) { return g(rng); });
    const MotionState other = moved(p.start, x);
    Vector12 e;
    e << log_se3(p.start.T_odom_end().inverse() * other.T_odom_end()), other.twist - p.start.twist;
    sampled += e * e.transpose() / samples;
  }
  const Matrix12 own = end_covariance(p.start, covariance);
  EXPECT_LT((own - sampled).norm(), 0.05 * sampled.norm());
}

}  // namespace
}  // namespace zloam::odometry
