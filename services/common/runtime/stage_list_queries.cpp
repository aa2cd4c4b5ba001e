#include <algorithm>

#include "common/messages/keys.hpp"
#include "common/runtime/stage_list.hpp"

namespace zloam::runtime {
namespace {

template <class Predicate>
std::vector<std::string> names_of_the_chain(Predicate wanted) {
  std::vector<std::string> names;
  for (const StageRow& row : stage_list()) {
    if (row.in_chain && wanted(row)) names.push_back(row.name);
  }
  return names;
}

bool holds(const std::vector<std::string>& patterns, std::string_view pattern) {
  return std::find(patterns.begin(), patterns.end(), pattern) != patterns.end();
}

}  // namespace

std::optional<std::size_t> stage_place(std::string_view name) {
  const auto& rows = stage_list();
  const auto found =
      std::find_if(rows.begin(), rows.end(), [&](const StageRow& row) { return row.name == name; });
  if (found == rows.end()) return std::nullopt;
  return static_cast<std::size_t>(found - rows.begin());
}

std::vector<std::string> stages_behind_the_source() {
  return names_of_the_chain([](const StageRow& row) { return !row.reads.empty(); });
}

std::vector<std::string> acknowledging_stages() {
  const std::string_view ack = key_row(Key::kFlowAck).pattern;
  return names_of_the_chain([&](const StageRow& row) { return holds(row.writes, ack); });
}

std::size_t stages_that_are_read() {
  const auto is_read = [](const std::string& pattern) {
    return std::any_of(stage_list().begin(), stage_list().end(),
                       [&](const StageRow& row) { return holds(row.reads, pattern); });
  };
  return static_cast<std::size_t>(
      std::count_if(stage_list().begin(), stage_list().end(), [&](const StageRow& row) {
        return std::any_of(row.writes.begin(), row.writes.end(), is_read);
      }));
}

std::vector<std::string> readers_of(Key key) {
  const std::string_view pattern = key_row(key).pattern;
  return names_of_the_chain([&](const StageRow& row) { return holds(row.reads, pattern); });
}

}  // namespace zloam::runtime
