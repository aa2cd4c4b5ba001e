#include <gtest/gtest.h>

#include "graph/place_image.hpp"
#include "graph/test_town.hpp"
#include "graph/verification.hpp"

namespace zloam::graph {
namespace {

const GraphConfig kConfig;

// Points in level axes with the heading of the pose, which may differ between two sessions.
std::vector<Eigen::Vector3f> seen(TestTown& town, const Pose& T_world_base) {
  std::vector<Eigen::Vector3f> points;
  for (const MapPoint& p : town.seen_from(T_world_base)) points.emplace_back(p.x, p.y, p.z);
  return points;
}

PlaceFeatures features(TestTown& town, const Pose& pose) {
  return place_features(place_image(seen(town, pose), kConfig.place), kConfig.place);
}

TEST(PlaceMatch, FindsAPlaceAtEveryHeading) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    TestTown town(seed);
    const PlaceFeatures a = features(town, pose_at(0.0, 0.0, 0.0));
    for (const double yaw : {0.0, 0.4, 1.6, -2.0, 3.1}) {
      const PlaceMatch match =
          match_places(a, features(town, pose_at(3.0, -2.0, yaw)), kConfig.place);
      ASSERT_GT(match.agreeing, 0U) << seed << ' ' << yaw;
      EXPECT_NEAR(std::remainder(match.yaw_rad - yaw, 2.0 * 3.14159265), 0.0, 0.05);
      EXPECT_LT((match.shift_m - Eigen::Vector2d(3.0, -2.0)).norm(), 1.5);
    }
  }
}

TEST(PlaceMatch, OtherTownsDoNotMatch) {
  std::size_t matched_wrongly = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    TestTown town(seed), other(seed + 100);
    const PlaceFeatures a = features(town, pose_at(0.0, 0.0, 0.0));
    if (match_places(a, features(other, pose_at(0.0, 0.0, 0.5)), kConfig.place).agreeing > 0) {
      ++matched_wrongly;
    }
  }
  // The few false matches are left to verification.
  EXPECT_LE(matched_wrongly, 2U);
}

TEST(Overlap, ComesToRestInTheRightPlaceAndKnowsHowWell) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    TestTown town(seed);
    const Surfaces a(seen(town, pose_at(0.0, 0.0, 0.0)));
    const Surfaces b(seen(town, pose_at(4.0, 1.0, 0.0)));
    Pose guess = Pose::Identity();
    guess.translation() << 4.5, 0.4, 0.2;
    guess.linear() = Eigen::AngleAxisd(0.02, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    const Overlap overlap = matched(a, b, guess, kConfig.verify);
    EXPECT_GT(overlap.share, kConfig.verify.overlap) << seed;
    EXPECT_GT(overlap.weakest_share, kConfig.verify.weakest_share) << seed;
    const Vector6 error = log_se3(overlap.T_a_b.inverse() * Pose(Eigen::Translation3d(4, 1, 0)));
    EXPECT_LT(error.head<3>().norm(), 0.03) << seed;
    for (int i = 0; i < 6; ++i) {
      EXPECT_LT(std::abs(error(i)), 4.0 * std::sqrt(overlap.covariance(i, i))) << seed << ' ' << i;
    }
  }
}

TEST(Overlap, OfAnotherPlaceIsLittle) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    TestTown town(seed), other(seed + 100);
    const Surfaces a(seen(town, pose_at(0.0, 0.0, 0.0))), b(seen(other, pose_at(0.0, 0.0, 0.0)));
    EXPECT_LT(matched(a, b, Pose::Identity(), kConfig.verify).share, kConfig.verify.overlap)
        << seed;
  }
}

TEST(Overlap, BetweenTwoWallsAloneIsWeakAlongThem) {
  TestTown street({{{-60.0, 5.0}, {60.0, 5.0}, 6.0}, {{-60.0, -5.0}, {60.0, -5.0}, 6.0}});
  const Surfaces a(seen(street, pose_at(0.0, 0.0, 0.0))), b(seen(street, pose_at(5.0, 0.0, 0.0)));
  Pose guess = Pose::Identity();
  guess.translation().x() = 2.0;
  const Overlap overlap = matched(a, b, guess, kConfig.verify);
  EXPECT_LT(overlap.weakest_share, kConfig.verify.weakest_share);
}

TEST(Surfaces, AreFewerThanThePointsAndLieOnThem) {
  TestTown town(3);
  const auto points = seen(town, pose_at(0.0, 0.0, 0.0));
  const Surfaces surfaces(points);
  EXPECT_LT(surfaces.fine.surfels().size(), points.size() / 3);
  std::size_t planes = 0;
  for (const Eigen::Vector3f& p : points) {
    const Surfel* surfel = surfaces.fine.at(p);
    ASSERT_NE(surfel, nullptr);
    if (!surfel->is_plane()) continue;
    ++planes;
    EXPECT_LT(std::abs(surfel->normal.dot(p - surfel->centre)), 0.3F);
  }
  EXPECT_GT(planes, points.size() / 3);
}

}  // namespace
}  // namespace zloam::graph
