#include <pcap/pcap.h>
#include <sys/stat.h>

#include <cerrno>
#include <cstring>

#include "driver/io/link_layer.hpp"
#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

struct PcapClose {
  void operator()(pcap_t* pcap) const { pcap_close(pcap); }
};

class PcapSource : public PacketSource {
 public:
  explicit PcapSource(const std::string& path) : path_(path) {
    struct stat status {};
    if (stat(path.c_str(), &status) != 0) throw SourceError(path + ": " + std::strerror(errno));
    if (S_ISDIR(status.st_mode)) throw SourceError(path + ": is a directory, not a capture file");
    if (status.st_size == 0) throw SourceError(path + ": the file is empty");
    char error[PCAP_ERRBUF_SIZE] = {};
    // Microsecond files are scaled by the library.
    pcap_.reset(
        pcap_open_offline_with_tstamp_precision(path.c_str(), PCAP_TSTAMP_PRECISION_NANO, error));
    if (!pcap_) throw SourceError(path + ": not a pcap or pcapng file (" + error + ")");
    link_type_ = pcap_datalink(pcap_.get());
    if (!link_type_known(link_type_)) {
      throw SourceError(path + ": link type " + std::to_string(link_type_) +
                        " is none of Ethernet, Linux cooked, raw IP, loopback");
    }
  }

  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    pcap_pkthdr* header = nullptr;
    const u_char* data = nullptr;
    while (complaint_.empty()) {
      const int result = pcap_next_ex(pcap_.get(), &header, &data);
      if (result == PCAP_ERROR_BREAK) break;
      if (result != 1) {
        complaint_ = path_ + ": ends early after " + std::to_string(frames_) +
                     " frames: " + pcap_geterr(pcap_.get());
        break;
      }
      ++frames_;
      if (!count(parse_frame(link_type_, {data, header->caplen}, datagram))) continue;
      // The library was asked for nanoseconds in this field.
      datagram.received_ns = static_cast<std::int64_t>(header->ts.tv_sec) * 1'000'000'000 +
                             static_cast<std::int64_t>(header->ts.tv_usec);
      return Read::kDatagram;
    }
    return Read::kEnd;
  }

  NamedCounts counts() const override {
    return {{"frames_read", frames_},
            {"frames_not_udp", other_},
            {"frames_fragment", fragments_},
            {"frames_cut", cut_}};
  }

  std::string complaint() const override { return complaint_; }

 private:
  bool count(FrameKind kind) {
    other_ += kind == FrameKind::kOther;
    fragments_ += kind == FrameKind::kFragment;
    cut_ += kind == FrameKind::kCut;
    return kind == FrameKind::kUdp;
  }

  std::string path_;
  std::unique_ptr<pcap_t, PcapClose> pcap_;
  int link_type_ = 0;
  std::string complaint_;
  std::uint64_t frames_ = 0;
  std::uint64_t other_ = 0;
  std::uint64_t fragments_ = 0;
  std::uint64_t cut_ = 0;
};

}  // namespace

std::unique_ptr<PacketSource> open_pcap(const std::string& path) {
  return std::make_unique<PcapSource>(path);
}

}  // namespace zloam::driver
