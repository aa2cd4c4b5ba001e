// Reads a robot's YAML file, values of the command line, and the JSON of a command.
#include <array>
#include <string>
#include <vector>

#include "common/runtime/parameters.hpp"

using namespace zloam::runtime;

namespace {

struct Fields {
  double number = 1.0;
  int count = 1;
  bool flag = false;
  std::string text;
  std::string choice = "a";
  Eigen::Vector3d place = Eigen::Vector3d::Zero();
  std::array<int, 3> cells{1, 1, 1};
  std::vector<std::string> list;
};

void bind(Parameters& p, Fields& f) {
  p.add("s.number", &f.number, {0.0, 10.0}, "m", "").live();
  p.add("s.deep.count", &f.count, {0, 10}, "", "").live();
  p.add("s.flag", &f.flag, "").live();
  p.add("s.text", &f.text, "");
  p.add("s.choice", &f.choice, {"a", "b"}, "").live();
  p.add("s.place", &f.place, {-1.0, 1.0}, "m", "").live();
  p.add("s.cells", &f.cells, {0, 9}, "", "");
  p.add("s.list", &f.list, "");
}

template <class Action>
void refused_or_done(Action action) {
  try {
    action();
  } catch (const ConfigError&) {
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  Fields fields;
  Parameters parameters;
  bind(parameters, fields);
  refused_or_done([&] { parameters.load_text(text, "fuzz", {}, {"other"}); });
  for (const char* key : {"s.number=", "s.text=", "s.place=", "s.list=", ""}) {
    refused_or_done([&] { parameters.load_text("", "fuzz", {key + text}, {"other"}); });
  }
  refused_or_done([&] { parameters.set_live(text); });
  refused_or_done([&] { parameters.check_live({text}, "fuzz"); });
  return 0;
}
