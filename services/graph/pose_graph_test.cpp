#include "graph/pose_graph.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <limits>
#include <random>

#include "common/geometry/motion_covariance.hpp"
#include "graph/expectation.hpp"

namespace zloam::graph {
namespace {

Vector6 random_vector(std::mt19937_64& random, double sigma_m, double sigma_rad) {
  std::normal_distribution<double> normal;
  Vector6 v;
  for (int i = 0; i < 6; ++i) v(i) = (i < 3 ? sigma_m : sigma_rad) * normal(random);
  return v;
}

struct Chain {
  std::vector<Pose> truth, start;
  std::vector<Between> factors;
};

Chain chain(std::size_t count, unsigned seed) {
  std::mt19937_64 random(seed);
  Chain out;
  out.truth.push_back(Pose::Identity());
  out.start.push_back(Pose::Identity());
  for (std::size_t i = 1; i < count; ++i) {
    const Pose step = exp_se3(random_vector(random, 5.0, 0.3));
    out.truth.push_back(out.truth.back() * step);
    Between factor{i - 1, i, step * exp_se3(random_vector(random, 0.1, 0.01)),
                   diagonal_covariance(0.1, 0.01), false};
    out.start.push_back(out.start.back() * factor.T_from_to);
    out.factors.push_back(factor);
  }
  return out;
}

TEST(PoseGraph, KeepsWhatFits) {
  const Chain c = chain(20, 1);
  const Optimised result = optimised(c.start, c.factors);
  ASSERT_TRUE(result.converged);
  EXPECT_NEAR(result.chi2_after, 0.0, 1e-9);
  for (std::size_t i = 0; i < c.start.size(); ++i) {
    EXPECT_LT((result.poses[i].matrix() - c.start[i].matrix()).norm(), 1e-6);
  }
}

TEST(PoseGraph, FindsPosesThatFitExactLoops) {
  Chain c = chain(30, 2);
  for (std::size_t i = 0; i + 10 < c.truth.size(); i += 2) {
    c.factors.push_back(
        {i, i + 10, c.truth[i].inverse() * c.truth[i + 10], diagonal_covariance(1e-4, 1e-5), true});
  }
  const Optimised result = optimised(c.start, c.factors);
  ASSERT_TRUE(result.converged);
  const auto off = [&](const std::vector<Pose>& poses) {
    return (poses[20].translation() - c.truth[20].translation()).norm();
  };
  EXPECT_GT(off(c.start), 0.3);
  EXPECT_LT(off(result.poses), 0.01);
}

TEST(PoseGraph, OneFalseLoopAmongManyBendsLittle) {
  Chain c = chain(30, 3);
  for (std::size_t i = 0; i + 10 < c.truth.size(); i += 2) {
    c.factors.push_back({i, i + 10, c.truth[i].inverse() * c.truth[i + 10],
                         diagonal_covariance(0.01, 0.001), true});
  }
  Between wrong{2, 27, Pose::Identity(), diagonal_covariance(0.01, 0.001), true};
  wrong.T_from_to.translation() << 3.0, -2.0, 1.0;
  c.factors.push_back(wrong);
  const Optimised result = optimised(c.start, c.factors);
  for (const std::size_t i : {10U, 20U, 29U}) {
    EXPECT_LT((result.poses[i].translation() - c.truth[i].translation()).norm(), 0.3) << i;
  }
  EXPECT_GT(chi2(wrong, result.poses[2], result.poses[27]), 1000.0);
}

TEST(PoseGraph, TheSameInputGivesTheSameBytes) {
  Chain c = chain(40, 4);
  c.factors.push_back({0, 39, c.truth[39], diagonal_covariance(0.01, 0.001), true});
  const Optimised first = optimised(c.start, c.factors), second = optimised(c.start, c.factors);
  for (std::size_t i = 0; i < first.poses.size(); ++i) {
    EXPECT_EQ(first.poses[i].matrix(), second.poses[i].matrix());
  }
}

TEST(Uncertainties, AreWhatSamplesOfTheChainSay) {
  const Chain c = chain(8, 5);
  const auto known = uncertainties(7, c.truth, c.factors);
  std::mt19937_64 random(6);
  Matrix6 sampled = Matrix6::Zero();
  constexpr int kSamples = 4000;
  for (int s = 0; s < kSamples; ++s) {
    Pose T_0_7 = Pose::Identity();
    for (std::size_t i = 1; i < c.truth.size(); ++i) {
      T_0_7 =
          T_0_7 * c.truth[i - 1].inverse() * c.truth[i] * exp_se3(random_vector(random, 0.1, 0.01));
    }
    const Vector6 error = log_se3((c.truth[0].inverse() * c.truth[7]).inverse() * T_0_7);
    sampled += error * error.transpose() / kSamples;
  }
  ASSERT_TRUE(known[0].has_value());
  for (int i = 0; i < 6; ++i) {
    EXPECT_NEAR(std::sqrt((*known[0])(i, i) / sampled(i, i)), 1.0, 0.1) << i;
  }
}

TEST(PoseGraph, SaysThatItDidNotComeToRest) {
  Chain c = chain(10, 7);
  EXPECT_TRUE(optimised(c.truth, c.factors).converged);
  c.factors.push_back({1, 8, Pose::Identity(), diagonal_covariance(0.01, 0.001), true});
  c.factors.back().T_from_to.translation().x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(optimised(c.truth, c.factors).converged);
}

TEST(PoseGraph, AMatrixThatIsNoCovarianceGivesNoResult) {
  Chain c = chain(10, 7);
  c.factors[4].covariance(0, 0) = -0.01;
  EXPECT_FALSE(optimised(c.start, c.factors).converged);
}

TEST(Uncertainties, ALoopMakesTheWayShorterInBothDirections) {
  Chain c = chain(30, 7);
  const auto without = uncertainties(29, c.truth, c.factors);
  c.factors.push_back(
      {1, 28, c.truth[1].inverse() * c.truth[28], diagonal_covariance(0.01, 0.001), true});
  const auto with = uncertainties(29, c.truth, c.factors);
  const auto back = uncertainties(1, c.truth, c.factors);
  EXPECT_LT(with[1]->trace(), 0.2 * without[1]->trace());
  EXPECT_LT(back[28]->trace(), 0.01);
  // The uncertainty is the same in both directions: carried from one end to the other they agree.
  const auto there = uncertainties(5, c.truth, c.factors)[2].value();
  const auto here = uncertainties(2, c.truth, c.factors)[5].value();
  const Matrix6 carry = adjoint(c.truth[5].inverse() * c.truth[2]);
  EXPECT_LT((carry * here * carry.transpose() - there).norm(), 1e-9);
}

}  // namespace
}  // namespace zloam::graph
