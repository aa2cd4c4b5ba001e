#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

constexpr std::size_t kPacketsPerRead = 256;

class PayloadFileSource : public PacketSource {
 public:
  PayloadFileSource(const std::string& path, std::size_t payload_bytes)
      : path_(path), payload_bytes_(payload_bytes), buffer_(kPacketsPerRead * payload_bytes) {
    struct stat status {};
    if (stat(path.c_str(), &status) != 0) throw SourceError(path + ": " + std::strerror(errno));
    if (payload_bytes == 0) {
      throw SourceError(path +
                        ": how long its packets are is not known: name the sensor's metadata in "
                        "driver.metadata");
    }
    if (S_ISDIR(status.st_mode)) throw SourceError(path + ": is a directory, not a packet file");
    if (status.st_size < static_cast<off_t>(payload_bytes)) {
      throw SourceError(path + ": " + std::to_string(status.st_size) +
                        " bytes are less than one packet of " + std::to_string(payload_bytes));
    }
    file_.open(path, std::ios::binary);
    if (!file_) throw SourceError(path + ": " + std::strerror(errno));
  }

  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    if (at_ + payload_bytes_ > filled_ && !refill()) return Read::kEnd;
    datagram = {};
    datagram.payload = std::span(buffer_).subspan(at_, payload_bytes_);
    at_ += payload_bytes_;
    return Read::kDatagram;
  }

  NamedCounts counts() const override { return {{"bytes_left_over", left_over_}}; }

  std::string complaint() const override {
    if (left_over_ == 0) return {};
    return path_ + ": " + std::to_string(left_over_) + " bytes at the end are no whole packet of " +
           std::to_string(payload_bytes_);
  }

 private:
  bool refill() {
    file_.read(reinterpret_cast<char*>(buffer_.data()),
               static_cast<std::streamsize>(buffer_.size()));
    filled_ = static_cast<std::size_t>(file_.gcount());
    at_ = 0;
    if (file_.bad()) throw SourceError(path_ + ": " + std::strerror(errno));
    left_over_ += filled_ % payload_bytes_;
    return filled_ >= payload_bytes_;
  }

  std::string path_;
  std::size_t payload_bytes_;
  std::ifstream file_;
  std::vector<std::uint8_t> buffer_;
  std::size_t filled_ = 0;
  std::size_t at_ = 0;
  std::uint64_t left_over_ = 0;
};

}  // namespace

std::unique_ptr<PacketSource> open_payload_file(const std::string& path,
                                                std::size_t payload_bytes) {
  return std::make_unique<PayloadFileSource>(path, payload_bytes);
}

}  // namespace zloam::driver
