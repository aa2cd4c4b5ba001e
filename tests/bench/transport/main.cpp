// zloam-bench-transport driver|registration|odometry [options of a stage]: a publisher of large
// sweeps (driver), or a reader. tests/bench/transport.py starts one publisher and several readers.

#include <cstdio>
#include <memory>
#include <string_view>

#include "publisher.hpp"
#include "reader.hpp"

namespace {

using namespace zloam;

int publish(int argc, char** argv) {
  bench::PublisherConfig config;
  std::unique_ptr<bench::Publisher> publisher;
  return runtime::run_stage(
      argc, argv,
      {.name = "driver",
       .summary = "Publishes sweeps of a chosen size.",
       .bind = [&](runtime::Parameters& p) { bench::bind(p, config); },
       .wire =
           [&](runtime::Stage& s) { publisher = std::make_unique<bench::Publisher>(config, s); }});
}

int read(const char* name, int argc, char** argv) {
  bench::ReaderConfig config;
  std::unique_ptr<bench::Reader> reader;
  return runtime::run_stage(
      argc, argv,
      {.name = name,
       .summary = "Reads sweeps and checks every byte.",
       .bind = [&](runtime::Parameters& p) { bench::bind(p, name, config); },
       .wire = [&](runtime::Stage& s) { reader = std::make_unique<bench::Reader>(config, s); }});
}

}  // namespace

int main(int argc, char** argv) {
  const std::string_view role = argc > 1 ? argv[1] : "";
  if (role == "driver") return publish(argc - 1, argv + 1);
  if (role == "registration" || role == "odometry") return read(argv[1], argc - 1, argv + 1);
  std::fprintf(stderr, "usage: zloam-bench-transport driver|registration|odometry [options]\n");
  return 2;
}
