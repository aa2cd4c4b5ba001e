// Commands of the graph: loops that a user adds and removes, and its files.

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "graph/graph_stage.hpp"

namespace zloam::graph {
namespace {

constexpr const char* kSeveralRuns =
    "several submaps have these sweeps, because the driver was restarted in this map: nothing was "
    "changed";

runtime::CommandReply refused(const std::string& why) { return {false, why, "{}"}; }

// The submaps that a command names by their two sweeps; or why there are none.
struct NamedEnds {
  NamedEnds(const nlohmann::json& arguments, const std::vector<Node>& nodes) {
    constexpr std::array<const char*, 2> kNames = {"from_sweep", "to_sweep"};
    for (std::size_t i = 0; i < kNames.size(); ++i) {
      const auto found = arguments.find(kNames[i]);
      if (found == arguments.end() || !found->is_number_unsigned()) {
        error = std::string(kNames[i]) + " is missing, or no sweep's number";
        return;
      }
      sweeps[i] = found->get<std::uint64_t>();
      for (std::size_t node = 0; node < nodes.size(); ++node) {
        if (nodes[node].sweep == sweeps[i]) submaps[i].push_back(node);
      }
      if (!submaps[i].empty()) continue;
      error = std::string(kNames[i]) + ": no submap has its frame there; see graph/poses";
      return;
    }
  }

  std::array<std::uint64_t, 2> sweeps{};
  std::array<std::vector<std::size_t>, 2> submaps;
  std::string error;
};

std::string too_near(double least_m) {
  std::ostringstream text;
  text << "the two submaps are less than " << least_m
       << " m of way apart: mapping has matched them to each other";
  return text.str();
}

std::string why_refused(const Loop& loop) {
  std::ostringstream text;
  text << "refused: " << verdict_name(loop.verdict) << " (overlap " << loop.overlap << ", chi2 "
       << loop.chi2 << ")";
  if (loop.forced) {
    text << "; the poses can't be fitted to it";
    return text.str();
  }
  if (loop.verdict == Verdict::kTakenBack) text << ", it contradicts the loops in force";
  text << "; with \"force\": true it is added "
       << (loop.overlap > 0.0 ? "all the same" : "where the two have a wall in common");
  return text.str();
}

}  // namespace

runtime::CommandReply GraphStage::with_loops(std::string message) const {
  const nlohmann::json results = {{"revision", graph_.revision()},
                                  {"loops", graph_.loops_in_force()}};
  return {true, std::move(message), results.dump()};
}

runtime::CommandReply GraphStage::add(const std::string& arguments_json) {
  const auto arguments = nlohmann::json::parse(arguments_json.empty() ? "{}" : arguments_json);
  const NamedEnds ends(arguments, graph_.nodes());
  if (!ends.error.empty()) return refused(ends.error);
  const auto force = arguments.value("force", nlohmann::json(false));
  if (!force.is_boolean()) return refused("force is neither true nor false");
  const std::array<std::vector<std::size_t>, 2>& at = ends.submaps;
  if (at[0].size() > 1 || at[1].size() > 1) return refused(kSeveralRuns);
  const auto [from, to] = std::minmax({at[0][0], at[1][0]});
  const double way_m = graph_.nodes()[to].way_m - graph_.nodes()[from].way_m;
  if (way_m < config_.loop_way_m) return refused(too_near(config_.loop_way_m));
  if (!graph_.in_force(ends.sweeps[0], ends.sweeps[1]).empty()) {
    return refused("this loop is already in force");
  }
  const Update update = graph_.add_loop(from, to, force.get<bool>());
  const Loop& loop = update.loops.back();
  if (loop.verdict != Verdict::kAccepted) return refused(why_refused(loop));
  publish(*last_, update);
  unsaved_ = true;
  return with_loops("loop added");
}

runtime::CommandReply GraphStage::remove(const std::string& arguments_json) {
  const auto arguments = nlohmann::json::parse(arguments_json.empty() ? "{}" : arguments_json);
  const NamedEnds ends(arguments, graph_.nodes());
  if (!ends.error.empty()) return refused(ends.error);
  const std::vector<Loop> loops = graph_.in_force(ends.sweeps[0], ends.sweeps[1]);
  if (loops.size() > 1) return refused(kSeveralRuns);
  const auto update = loops.empty() ? std::nullopt : graph_.remove(loops[0].from, loops[0].to);
  if (!update) return refused("no loop is in force between these submaps");
  publish(*last_, *update);
  unsaved_ = true;
  return with_loops("loop removed");
}

runtime::CommandReply GraphStage::save() {
  if (config_.output_dir.empty()) return {false, "no file: graph.output_dir is not set", "{}"};
  const std::string error = write_files();
  if (!error.empty()) return {false, error, "{}"};
  const nlohmann::json results = {{"poses", path_.size()}, {"revision", graph_.revision()}};
  return {true, "trajectory and map written to " + config_.output_dir, results.dump()};
}

}  // namespace zloam::graph
