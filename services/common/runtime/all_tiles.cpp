#include "common/runtime/all_tiles.hpp"

#include <chrono>
#include <utility>

namespace zloam::runtime {
namespace {

constexpr std::chrono::milliseconds kWithin{10'000};

}  // namespace

AllTiles::AllTiles(Stage& stage, std::string shown) : stage_(stage), shown_(std::move(shown)) {}

void AllTiles::ask(bool has_none) {
  const std::int64_t now_ns = steady_ns();
  const bool again = has_none && now_ns - asked_ns_ > AskAgain::kFirstPause_ns;
  if (get_.started() || !(asking_.due(now_ns) || again)) return;
  asking_.asked();
  asked_ns_ = now_ns;
  get_.start(stage_.session(), stage_.keys().all_tiles(), kWithin, bell_);
}

std::vector<zenoh::Sample> AllTiles::take() {
  auto tiles = get_.take();
  if (!tiles) return {};
  const std::string& error = get_.error();
  asking_.answered(error.empty(), steady_ns());
  std::string lack;
  if (!error.empty()) {
    lack = "not all tiles of the map came (" + error + "): " + shown_ +
           " may lack parts; they are requested again";
  }
  stage_.degraded("tiles", lack);
  return std::move(*tiles);
}

}  // namespace zloam::runtime
