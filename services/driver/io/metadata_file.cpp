#include "driver/io/metadata_file.hpp"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "driver/decoder/makers.hpp"
#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

namespace fs = std::filesystem;

// Well above the longest metadata known; a longer file is not metadata.
constexpr std::size_t kMostBytes = std::size_t{1} << 20;

std::string beside(const std::string& capture) {
  const fs::path stem = fs::path(capture).replace_extension();
  for (const char* ending : {".json", "_0.json"}) {
    const std::string path = stem.string() + ending;
    if (fs::is_regular_file(path)) return path;
  }
  return {};
}

/// The file as UTF-8 without the mark with which editors and shells of Windows begin it.
std::string plain_text_of(const std::string& path) {
  std::string text = text_of_metadata(path);
  if (text.starts_with("\xFF\xFE") || text.starts_with("\xFE\xFF")) {
    throw SourceError(path + ": is UTF-16; UTF-8 is expected");
  }
  if (text.starts_with("\xEF\xBB\xBF")) text.erase(0, 3);
  return text;
}

}  // namespace

std::string text_of_metadata(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file || fs::is_directory(path)) {
    throw SourceError(path + ": " + std::strerror(file ? EISDIR : errno));
  }
  std::string text(kMostBytes + 1, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(file.gcount()));
  if (text.size() > kMostBytes) {
    throw SourceError(path + ": is longer than 1 MiB, which no sensor's description is");
  }
  return text;
}

void read_metadata(const std::string& named, const std::string& capture, DecodingOptions& options) {
  const std::string path = named.empty() && !capture.empty() ? beside(capture) : named;
  if (path.empty()) return;
  try {
    options.metadata = plain_text_of(path);
  } catch (const SourceError&) {
    if (!named.empty()) throw;
    return;  // unreadable, but not named by the user: may not belong to the capture
  }
  options.metadata_name = path;
  const std::string error = Makers(options).metadata_error();
  if (!named.empty() && !error.empty()) throw SourceError(path + ": " + error);
}

}  // namespace zloam::driver
