// zloam-store: map tiles at rest. Everything of substance is in tile_store.hpp (what is kept),
// record_log.hpp (how it survives) and store_stage.hpp (keys, answers).

#include <cstdlib>
#include <memory>

#include "store/file.hpp"
#include "store/store_parameters.hpp"
#include "store/store_stage.hpp"

int main(int argc, char** argv) {
  if (const char* n = std::getenv("ZLOAM_FAULT_STORE_WRITE")) {
    zloam::store::die_at_change(std::strtoull(n, nullptr, 10));
  }
  zloam::store::StoreConfig config;
  std::unique_ptr<zloam::store::StoreStage> store;
  return zloam::runtime::run_stage(argc, argv,
                                   {.name = "store",
                                    .summary = "keeps map tiles on disk and answers gets for them",
                                    .bind = [&](zloam::runtime::Parameters& p) { bind(p, config); },
                                    .wire =
                                        [&](zloam::runtime::Stage& stage) {
                                          store = std::make_unique<zloam::store::StoreStage>(
                                              stage, config);
                                        }});
}
