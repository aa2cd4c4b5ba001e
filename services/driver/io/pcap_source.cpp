#include <pcap/pcap.h>
#include <sys/stat.h>

#include <cerrno>
#include <cstring>

#include "driver/io/link_layer.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/io/pcapng_reader.hpp"

namespace zloam::driver {
namespace {

struct PcapClose {
  void operator()(pcap_t* pcap) const { pcap_close(pcap); }
};

// In so many packets of a sensor there is less than one of the network itself (mDNS, DHCP).
constexpr std::uint64_t kFewAmong = 100;
constexpr const char* kNoneOfOurs = ", which is none of Ethernet, Linux cooked, raw IP, loopback";

/// Frames of a pcap or pcapng file.
class Frames {
 public:
  virtual ~Frames() = default;
  /// False at the end; error() is set if the file ends early.
  virtual bool next(CapturedFrame& frame) = 0;
  virtual std::string error() const = 0;
};

class PcapFrames : public Frames {
 public:
  explicit PcapFrames(const std::string& path) {
    char error[PCAP_ERRBUF_SIZE] = {};
    // The library converts files with microseconds.
    pcap_.reset(
        pcap_open_offline_with_tstamp_precision(path.c_str(), PCAP_TSTAMP_PRECISION_NANO, error));
    if (!pcap_) throw SourceError(path + ": not a pcap or pcapng file (" + error + ")");
    link_type_ = pcap_datalink(pcap_.get());
    if (!link_type_known(link_type_)) {
      throw SourceError(path + ": link type " + std::to_string(link_type_) + kNoneOfOurs);
    }
  }

  bool next(CapturedFrame& frame) override {
    pcap_pkthdr* header = nullptr;
    const u_char* data = nullptr;
    const int result = pcap_next_ex(pcap_.get(), &header, &data);
    if (result != 1) {
      failed_ = result != PCAP_ERROR_BREAK;
      return false;
    }
    frame.link_type = link_type_;
    frame.data = {data, header->caplen};
    // tv_usec holds nanoseconds, as requested when the file was opened.
    frame.received_ns = static_cast<std::int64_t>(header->ts.tv_sec) * 1'000'000'000 +
                        static_cast<std::int64_t>(header->ts.tv_usec);
    return true;
  }

  std::string error() const override { return failed_ ? pcap_geterr(pcap_.get()) : ""; }

 private:
  std::unique_ptr<pcap_t, PcapClose> pcap_;
  int link_type_ = 0;
  bool failed_ = false;
};

class PcapngFrames : public Frames {
 public:
  explicit PcapngFrames(const std::string& path) : reader_(path) {}
  bool next(CapturedFrame& frame) override { return reader_.next(frame); }
  std::string error() const override { return reader_.error(); }

 private:
  PcapngReader reader_;
};

std::unique_ptr<Frames> open_frames(const std::string& path) {
  struct stat status {};
  if (stat(path.c_str(), &status) != 0) throw SourceError(path + ": " + std::strerror(errno));
  if (S_ISDIR(status.st_mode)) throw SourceError(path + ": is a directory, not a capture file");
  if (status.st_size == 0) throw SourceError(path + ": the file is empty");
  if (PcapngReader::is_pcapng(path)) return std::make_unique<PcapngFrames>(path);
  return std::make_unique<PcapFrames>(path);
}

class PcapSource : public PacketSource {
 public:
  explicit PcapSource(const std::string& path) : path_(path), frames_(open_frames(path)) {}

  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    CapturedFrame frame;
    while (!ended_) {
      if (!frames_->next(frame)) {
        ended_ = true;
        break;
      }
      ++read_;
      datagram.received_ns = frame.received_ns;
      if (!link_type_known(frame.link_type)) {
        ++other_link_;
        unknown_link_type_ = frame.link_type;
      } else if (count(parse_frame(frame.link_type, frame.data, fragments_, datagram))) {
        return Read::kDatagram;
      }
    }
    return Read::kEnd;
  }

  NamedCounts counts() const override {
    return {{"frames_read", read_},
            {"frames_not_udp", other_},
            {"frames_ipv6", ipv6_},
            {"frames_other_link", other_link_},
            {"frames_fragment", fragment_frames_},
            {"datagrams_not_whole", fragments_.incomplete()},
            {"frames_cut", cut_}};
  }

  std::string complaint() const override {
    std::string text;
    const auto add = [&](const std::string& sentence) {
      text += (text.empty() ? path_ + ": " : "; ") + sentence;
    };
    if (const std::string error = frames_->error(); !error.empty()) {
      add("ends early after " + std::to_string(read_) + " frames: " + error);
    }
    if (!ended_) return text;
    if (other_link_ > 0) {
      add(std::to_string(other_link_) + " frames of link type " +
          std::to_string(unknown_link_type_) + kNoneOfOurs + ", were passed over");
    }
    if (ipv6_ > kFewAmong * datagrams_) {
      add("its " + std::to_string(ipv6_) + " IPv6 packets are not read, and only " +
          std::to_string(datagrams_) +
          " IPv4 packets hold a datagram: set the sensor to send by IPv4");
    }
    if (cut_ > 0) {
      add(std::to_string(cut_) +
          " frames hold less than their packet: record with a greater snap length (tcpdump -s 0)");
    }
    if (fragments_.incomplete() > 0) {
      add(std::to_string(fragments_.incomplete()) + " datagrams lack some of their IP fragments");
    }
    return text;
  }

 private:
  bool count(FrameKind kind) {
    datagrams_ += kind == FrameKind::kUdp;
    other_ += kind == FrameKind::kOther;
    ipv6_ += kind == FrameKind::kIpv6;
    fragment_frames_ += kind == FrameKind::kFragment;
    cut_ += kind == FrameKind::kCut;
    return kind == FrameKind::kUdp;
  }

  std::string path_;
  std::unique_ptr<Frames> frames_;
  IpFragments fragments_;
  bool ended_ = false;
  std::uint64_t read_ = 0;
  std::uint64_t datagrams_ = 0;
  std::uint64_t other_ = 0;
  std::uint64_t ipv6_ = 0;
  std::uint64_t other_link_ = 0;
  int unknown_link_type_ = 0;
  std::uint64_t fragment_frames_ = 0;
  std::uint64_t cut_ = 0;
};

}  // namespace

std::unique_ptr<PacketSource> open_pcap(const std::string& path) {
  return std::make_unique<PcapSource>(path);
}

}  // namespace zloam::driver
