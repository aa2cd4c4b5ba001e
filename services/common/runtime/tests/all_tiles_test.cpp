#include "common/runtime/all_tiles.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <optional>

#include "common/runtime/tests/support.hpp"

namespace zloam::runtime {
namespace {

using test::kKeys;
using test::Network;
using test::RunningStage;
using test::setup;
using test::Watched;

TEST(AllTiles, AreRequestedAgainWhileNotAllOfThemCome) {
  const Network network(2);
  zenoh::Session store = network.open(1);
  std::atomic<bool> has_all{false};
  const zenoh::Queryable queryable =
      store.declare_queryable(kKeys.all_tiles(), [&](zenoh::Query&& query) {
        query.reply(kKeys.tile("plane", 1, 0, 0), zenoh::Bytes::copy_of(std::string_view("one")));
        if (!has_all) query.reply_error(zenoh::Bytes::copy_of(std::string_view("a broken file")));
      });
  std::optional<AllTiles> tiles;
  Watched<int> came;
  RunningStage stage(network.open(0), setup("preview"), [&](Stage& core) {
    tiles.emplace(core, "the preview");
    tiles->want();
    core.every(std::chrono::milliseconds(20), [&] {
      tiles->ask(came.get() == 0);
      const auto taken = static_cast<int>(tiles->take().size());
      if (taken > 0) came.change([taken](int& n) { n += taken; });
    });
  });
  ASSERT_TRUE(came.wait([](int n) { return n > 0; }));
  EXPECT_THAT(stage->status().reason,
              testing::AllOf(testing::HasSubstr("(a broken file)"),
                             testing::HasSubstr("the preview may lack parts")));
  const int before = came.get();
  has_all = true;
  while (stage->status().health == ServiceHealth::kDegraded) std::this_thread::yield();
  EXPECT_TRUE(came.wait([before](int n) { return n > before; }));
}

}  // namespace
}  // namespace zloam::runtime
