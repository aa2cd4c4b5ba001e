// zloam-sessions: joins the saved maps of several runs by the places that they share.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "sessions/merged_files.hpp"
#include "sessions/merged_store.hpp"
#include "sessions/result_folder.hpp"

namespace zloam::sessions {
namespace {

constexpr int kIncomplete = 1, kUsage = 2, kFailed = 3;

struct Options {
  std::vector<std::string> maps;
  std::string out;
  bool quiet = false;
};

Options parse(int argc, char** argv) {
  Options options;
  CLI::App app(
      "merges maps of several runs into one frame by the places that they share; with one map: "
      "closes its loops",
      "zloam-sessions");
  app.footer(
      "Writes sessions.json, map.pcd, graph.g2o and submaps_1.tum, submaps_2.tum and so on, in the "
      "frame of the first map, and the joined maps as a map to localize in. Exit codes: 0 all maps "
      "are joined; 1 something is missing: a map "
      "has too little in common with the others and is left out of map.pcd, or is damaged; 2 wrong "
      "command line; 3 a file can't be read or "
      "written.");
  app.add_option("MAP", options.maps, "map folder of a run (MAP=folder, --map folder)")->required();
  app.add_option("--out", options.out, "folder for the output files; new or empty")->required();
  app.add_flag("--quiet", options.quiet, "print no progress");
  app.set_version_flag("--version", "zloam-sessions " ZLOAM_VERSION);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    std::exit(app.exit(error) == 0 ? 0 : kUsage);
  }
  return options;
}

/// A map and its copy would confirm each other everywhere, and be counted as two drives. So would a
/// merged map and one of those in it.
void refuse_same(const std::vector<SavedMap>& maps, const SavedMap& map) {
  for (const SavedMap& other : maps) {
    if (!common_run(other, map)) continue;
    const bool is_same = other.run == map.run && other.submaps.size() == map.submaps.size() &&
                         other.submaps.front().instant_ns == map.submaps.front().instant_ns;
    throw SavedMapError(other.folder.string() + " and " + map.folder.string() +
                        (is_same ? " are one map, which the same run began: name it once"
                                 : " hold the same drive: name only one of them"));
  }
}

Merged merged(const Options& options) {
  Merged out{{}, graph::LoopGraph(graph::GraphConfig{})};
  std::size_t total = 0, done = 0;
  for (const std::string& folder : options.maps) {
    SavedMap map = read_saved_map(folder);
    refuse_same(out.maps, map);
    total += map.submaps.size();
    out.maps.push_back(std::move(map));
  }
  for (std::size_t session = 0; session < out.maps.size(); ++session) {
    for (const Submap& submap : out.maps[session].submaps) {
      out.graph.add(submap, session);
      if (!options.quiet && ++done % 10 == 0) {
        std::fprintf(stderr, "\rsubmaps looked at: %zu of %zu", done, total);
      }
    }
  }
  if (!options.quiet) std::fprintf(stderr, "\rsubmaps looked at: %zu of %zu\n", done, total);
  return out;
}

/// Throws if a file can't be written.
void write(const Merged& found, const std::filesystem::path& folder) {
  ResultFolder out(folder);
  std::string error = write_submap_poses(found, out.path());
  if (error.empty()) error = write_g2o(found, out.path() / "graph.g2o");
  if (error.empty()) error = write_points(found, out.path() / "map.pcd");
  if (error.empty()) error = write_store(found, out.path());
  if (error.empty()) error = write_report(found, out.path() / "sessions.json");
  if (!error.empty()) throw std::runtime_error(error);
  out.keep();
}

int verdict(const Merged& found) {
  int code = 0;
  for (std::size_t i = 0; i < found.maps.size(); ++i) {
    const SavedMap& map = found.maps[i];
    if (map.damaged) {
      std::cerr << "zloam-sessions: " << map.folder.string() << " is damaged: " << map.unread_bytes
                << " bytes and " << map.unread_files
                << " files of it can't be read (records of an unknown format: "
                << map.unread_records << "); what they held is missing"
                << (map.missing.empty() ? "" : " (not there: " + map.missing + ")") << "\n";
      code = kIncomplete;
    }
    if (found.is_joined(i)) continue;
    std::cerr << "zloam-sessions: " << map.folder.string()
              << ": shares too little with the other maps to be joined to them; it is left out\n";
    code = kIncomplete;
  }
  if (!found.graph.fitted()) {
    std::cerr << "zloam-sessions: the loops could not be fitted: poses are those of the maps\n";
    code = kIncomplete;
  }
  for (const std::string& part : lacking(found)) {
    std::cerr << "zloam-sessions: " << part << "\n";
    code = kIncomplete;
  }
  for (const std::string& note : notes(found)) std::cerr << "zloam-sessions: " << note << "\n";
  return code;
}

}  // namespace
}  // namespace zloam::sessions

int main(int argc, char** argv) {
  using namespace zloam::sessions;
  const Options options = parse(argc, argv);
  try {
    // Refused before the work, too.
    refuse_filled(options.out);
    const Merged found = merged(options);
    write(found, options.out);
    return verdict(found);
  } catch (const std::exception& error) {
    std::cerr << "zloam-sessions: " << error.what() << "\n";
    return kFailed;
  }
}
