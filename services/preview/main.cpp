// zloam-preview: map and pose for a thin link. The work is done in preview.hpp (what is sent, and
// when), octree.hpp (encoding) and preview_stage.hpp (keys).

#include <memory>

#include "preview/preview_stage.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  std::unique_ptr<preview::PreviewStage> preview;
  return runtime::run_stage(argc, argv,
                            {.name = "preview",
                             .summary = "publishes the pose and a coarse map for links of 50 kB/s",
                             .bind = [](runtime::Parameters&) {},
                             .wire =
                                 [&](runtime::Stage& stage) {
                                   preview = std::make_unique<preview::PreviewStage>(stage);
                                 }});
}
