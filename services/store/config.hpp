#pragma once
// Configuration of the store. Defaults are written here and nowhere else.

#include <string>

namespace zloam::store {

struct StoreConfig {
  /// folder of the log
  std::string path = "out/tiles";
  int sync_ms = 1000;
  int sync_mib = 8;
};

}  // namespace zloam::store
