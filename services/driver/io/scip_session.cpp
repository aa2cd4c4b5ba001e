#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>

#include "driver/io/packet_source.hpp"
#include "driver/io/scip_link.hpp"

namespace zloam::driver {
namespace {

constexpr std::size_t kHeadBytes = 12;
// Limit for one record, which holds the bytes of one read call.
constexpr std::uint32_t kMostBytes = 1 << 20;

std::uint32_t big_endian(const char* at) {
  std::uint32_t value = 0;
  for (int i = 0; i < 4; ++i) value = (value << 8) | static_cast<unsigned char>(at[i]);
  return value;
}

class SessionFile : public ScipLink {
 public:
  explicit SessionFile(const std::string& path) : path_(path), file_(path, std::ios::binary) {
    if (!file_) throw SourceError(path + ": " + std::strerror(errno));
  }

  Read read(std::vector<std::uint8_t>& bytes, std::int64_t& received_ns,
            int /*timeout_ms*/) override {
    std::array<char, kHeadBytes> head{};
    file_.read(head.data(), head.size());
    if (file_.gcount() == 0) return Read::kClosed;
    const std::uint32_t length = big_endian(&head[8]);
    const bool whole = file_.gcount() == static_cast<std::streamsize>(head.size());
    if (!whole || length > kMostBytes) return cut();
    bytes.resize(length);
    file_.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(length));
    if (file_.gcount() != static_cast<std::streamsize>(length)) return cut();
    received_ns = 1'000'000'000 * static_cast<std::int64_t>(big_endian(&head[0])) +
                  1'000 * static_cast<std::int64_t>(big_endian(&head[4]));
    return Read::kBytes;
  }

  void write(const std::string& /*bytes*/) override {}
  std::string why() const override { return why_; }

 private:
  Read cut() {
    why_ = path_ + ": ends within a record, or is no recorded session; what came before is used";
    return Read::kClosed;
  }

  std::string path_;
  std::ifstream file_;
  std::string why_;
};

}  // namespace

std::unique_ptr<ScipLink> open_scip_session(const std::string& path) {
  return std::make_unique<SessionFile>(path);
}

}  // namespace zloam::driver
