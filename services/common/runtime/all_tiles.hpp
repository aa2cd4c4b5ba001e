#pragma once
// All tiles of the current map, requested when they are wanted, and again while not all of them
// come; the stage is degraded meanwhile. Changed tiles arrive by subscription, not here.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/runtime/ask_again.hpp"
#include "common/runtime/async_get.hpp"
#include "common/runtime/stage.hpp"

namespace zloam::runtime {

class AllTiles {
 public:
  /// shown: what lacks parts while tiles are missing, for the status.
  AllTiles(Stage& stage, std::string shown);

  /// The next ask() requests them.
  void want() { asking_.want(); }
  /// Requests them if it is time. has_none: no tile has come yet, so they are requested again after
  /// a pause although the last answer was whole: it is empty while a link is not up yet.
  void ask(bool has_none = false);
  /// The requested tiles, once all have arrived or their time is over.
  std::vector<zenoh::Sample> take();
  /// Nobody reads what they are for, so none is missing.
  void no_reader() { stage_.degraded("tiles", ""); }

 private:
  Stage& stage_;
  std::string shown_;
  AskAgain asking_;
  AsyncGet get_;
  std::shared_ptr<Shared> bell_ = std::make_shared<Shared>();
  std::int64_t asked_ns_ = 0;
};

}  // namespace zloam::runtime
