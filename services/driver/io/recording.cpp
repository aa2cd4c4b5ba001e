#include "driver/io/recording.hpp"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstring>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "common/messages/verify.hpp"
#include "driver/io/message_fields.hpp"
#include "driver/scan/plausible.hpp"

extern char** environ;

namespace zloam::driver {
namespace {

constexpr std::string_view kMagic = "ZLRC";
constexpr std::uint64_t kLongestText = 1 << 16;
// Upper bound of a plausible frame: 20 million points.
constexpr std::uint64_t kLargestSweep = sizeof(RecordedSweep) + 20'000'000 * sizeof(Point);
// Assumed firings per revolution if the points have no times.
constexpr double kColumns = 1800.0;

const std::string& name_of(TimeModel model) {
  return std::find_if(kTimeModels.begin(), kTimeModels.end(),
                      [model](const auto& named) { return named.second == model; })
      ->first;
}

/// A child process whose output is read; the destructor ends it.
class Reader {
 public:
  explicit Reader(std::vector<std::string> words) : name_(words.front()) {
    std::array<int, 2> ends{};
    if (pipe(ends.data()) != 0) throw SourceError("no pipe: " + std::string(std::strerror(errno)));
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    posix_spawn_file_actions_addclose(&actions, ends[0]);
    const int error =
        posix_spawnp(&pid_, arguments[0], &actions, nullptr, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    from_ = ends[0];
    if (error == 0) return;
    ::close(from_);
    throw SourceError(name_ + " (driver.reader), which reads recordings: " + std::strerror(error));
  }
  ~Reader() {
    ::close(from_);
    ::kill(pid_, SIGTERM);
    ::waitpid(pid_, nullptr, 0);
  }
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;

  /// Throws SourceError if the output ends before.
  void read(void* into, std::size_t bytes) {
    auto* at = static_cast<char*>(into);
    while (bytes > 0) {
      const ssize_t got = ::read(from_, at, bytes);
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) {
        throw SourceError(name_ +
                          " (driver.reader) ended within the recording; its own words are "
                          "in this log");
      }
      at += got;
      bytes -= static_cast<std::size_t>(got);
    }
  }

 private:
  std::string name_;
  pid_t pid_ = 0;
  int from_ = -1;
};

std::vector<std::string> words_of(const RecordingOptions& options) {
  std::vector<std::string> words = {options.reader, "recording",
                                    options.path,   "--stream",
                                    "--topic",      options.topic,
                                    "--time-field", options.time_field,
                                    "--time-model", name_of(options.timing.model),
                                    "--period-s",   std::to_string(options.timing.period_s),
                                    "--seam-deg",   std::to_string(options.timing.seam_deg)};
  if (options.imu) words.insert(words.end(), {"--imu", "--imu-topic", options.imu_topic});
  return words;
}

/// The reader's output, frame by frame; problems that it reports are kept as remarks.
class Frames {
 public:
  explicit Frames(const RecordingOptions& options)
      : path_(options.path), reader_(words_of(options)) {}

  const std::string& path() const { return path_; }

  std::string identity() {
    const std::optional<FrameHead> head = next();
    if (!head || head->kind != static_cast<std::uint32_t>(FrameKind::kIdentity)) throw foreign();
    return text_of(*head);
  }

  /// The next frame with data, which must be of this kind; nothing at the end.
  std::optional<FrameHead> next(FrameKind kind) {
    const std::optional<FrameHead> head = next();
    if (head && head->kind != static_cast<std::uint32_t>(kind)) throw foreign();
    return head;
  }

  void read(void* into, std::size_t bytes) { reader_.read(into, bytes); }

  void remark(const std::string& text) { remarks_.push_back(path_ + ": " + text); }
  const std::vector<std::string>& remarks() const { return remarks_; }
  std::vector<ImuReading> take_imu() { return std::exchange(imu_, {}); }

  SourceError foreign() const {
    return SourceError(path_ +
                       ": what driver.reader writes is not what is expected: are both of one "
                       "version?");
  }

 private:
  std::optional<FrameHead> next() {
    while (!ended_) {
      FrameHead head{};
      reader_.read(&head, sizeof head);
      if (std::string_view(head.magic, sizeof head.magic) != kMagic) throw foreign();
      switch (static_cast<FrameKind>(head.kind)) {
        case FrameKind::kRemark:
          remark(text_of(head));
          break;
        case FrameKind::kRefusal:
          throw SourceError(path_ + ": " + text_of(head));
        case FrameKind::kEnd:
          ended_ = true;
          break;
        case FrameKind::kReading:
          keep_reading(head);
          break;
        default:
          return head;
      }
    }
    return std::nullopt;
  }

  void keep_reading(const FrameHead& head) {
    RecordedReading r{};
    if (head.bytes != sizeof r) throw foreign();
    reader_.read(&r, sizeof r);
    imu_.push_back({r.stamp_ns, Eigen::Vector3d(r.force_mps2), Eigen::Vector3d(r.rate_radps)});
  }

  std::string text_of(const FrameHead& head) {
    if (head.bytes > kLongestText) throw foreign();
    std::string text(head.bytes, '\0');
    reader_.read(text.data(), text.size());
    return text;
  }

  std::string path_;
  Reader reader_;
  std::vector<std::string> remarks_;
  std::vector<ImuReading> imu_;
  bool ended_ = false;
};

/// Time between two firings of a laser: the mean of the steps near the median, because times may be
/// rounded and missing returns make longer steps.
double firing_period_ns(const DecodedSweep& sweep) {
  std::vector<std::int64_t> last_ns(sweep.rings, -1);
  std::vector<double> steps_ns;
  for (const Point& p : sweep.points) {
    std::int64_t& before_ns = last_ns[std::min<std::size_t>(p.ring, last_ns.size() - 1)];
    if (before_ns >= 0 && p.time_ns > before_ns) {
      steps_ns.push_back(static_cast<double>(p.time_ns - before_ns));
    }
    before_ns = p.time_ns;
  }
  if (steps_ns.empty()) return std::max(1.0, sweep.period_ns / kColumns);
  const auto middle = steps_ns.begin() + static_cast<std::ptrdiff_t>(steps_ns.size() / 2);
  std::nth_element(steps_ns.begin(), middle, steps_ns.end());
  const double usual_ns = *middle;
  double sum_ns = 0.0, count = 0.0;
  for (const double step_ns : steps_ns) {
    if (step_ns < 0.5 * usual_ns || step_ns > 1.5 * usual_ns) continue;
    sum_ns += step_ns;
    count += 1.0;
  }
  return sum_ns / count;
}

class RecordedClouds : public ScanFolder {
 public:
  explicit RecordedClouds(std::unique_ptr<Frames> frames) : frames_(std::move(frames)) {}

  bool next(DecodedSweep& sweep) override {
    const auto head = frames_->next(FrameKind::kSweep);
    if (!head) return false;
    read_sweep(*head, sweep);
    if (const std::string why = implausible(sweep); !why.empty()) leave_out(why, sweep);
    judged_ = judged_ || sweep.points.size() >= kJudgedReturns;
    number_columns(sweep);
    ++sweeps_;
    return true;
  }

  const std::vector<std::string>& files() const override { return files_; }
  NamedCounts counts() const override { return {{"scans", sweeps_}, {"scans_spoilt", spoilt_}}; }
  std::vector<std::string> remarks() const override { return frames_->remarks(); }
  std::vector<ImuReading> take_imu() override { return frames_->take_imu(); }

 private:
  void read_sweep(const FrameHead& head, DecodedSweep& sweep) {
    const bool sound = head.bytes >= sizeof(RecordedSweep) && head.bytes <= kLargestSweep &&
                       (head.bytes - sizeof(RecordedSweep)) % sizeof(Point) == 0;
    if (!sound) throw frames_->foreign();
    RecordedSweep about{};
    frames_->read(&about, sizeof about);
    sweep = {};
    sweep.points.resize((head.bytes - sizeof about) / sizeof(Point));
    frames_->read(sweep.points.data(), head.bytes - sizeof about);
    sweep.stamp_ns = about.stamp_ns;
    sweep.period_ns = about.period_ns;
    sweep.rings = about.rings;
    sweep.model = "recorded";
    sweep.clock_source = ClockSource::kCapture;
    sweep.deskewed = about.deskewed != 0;
    sweep.complete = about.complete != 0;
  }

  void leave_out(const std::string& why, DecodedSweep& sweep) {
    if (!judged_) throw SourceError(frames_->path() + ": " + why);
    // Only the first few are named individually: any number may follow, each with its own figure.
    if (spoilt_ < kNamed) frames_->remark(why + ": the cloud is left out");
    if (spoilt_ == kNamed) frames_->remark("further clouds are left out for such reasons");
    ++spoilt_;
    sweep.points.clear();
  }

  /// Numbers columns by firing time, so that a missing return skips a number and neighbours along a
  /// ring differ by one.
  static void number_columns(DecodedSweep& sweep) {
    if (sweep.rings == 0) {
      sweep.columns.assign(sweep.points.size(), 0);
      return;
    }
    const double firing_ns = firing_period_ns(sweep);
    std::vector<std::int64_t> first_ns(sweep.rings, -1);
    for (const Point& p : sweep.points) {
      std::int64_t& begin_ns = first_ns[std::min<std::size_t>(p.ring, first_ns.size() - 1)];
      if (begin_ns < 0) begin_ns = p.time_ns;
      const double begun = std::round(static_cast<double>(begin_ns) / firing_ns);
      const double since = static_cast<double>(p.time_ns - begin_ns) / firing_ns;
      sweep.columns.push_back(static_cast<std::uint16_t>(begun + std::round(since)));
    }
  }

  static constexpr std::uint64_t kNamed = 10;

  std::unique_ptr<Frames> frames_;
  std::vector<std::string> files_;
  std::uint64_t sweeps_ = 0;
  std::uint64_t spoilt_ = 0;
  bool judged_ = false;
};

/// Sweeps as a driver published them: points that it masked are missing, all other fields are
/// unchanged.
class RecordedMessages : public ScanFolder {
 public:
  explicit RecordedMessages(std::unique_ptr<Frames> frames) : frames_(std::move(frames)) {}

  bool next(DecodedSweep& sweep) override {
    const auto head = frames_->next(FrameKind::kMessage);
    if (!head) return false;
    if (!fits(Key::kSweep, head->bytes)) throw frames_->foreign();
    // From the allocator, whose alignment suffices for any message.
    std::vector<std::uint8_t> bytes(head->bytes);
    frames_->read(bytes.data(), bytes.size());
    const VerifyResult verdict = verify<msg::Sweep>(bytes, encoding_of(Key::kSweep));
    if (!verdict.ok()) throw SourceError(frames_->path() + ": " + verdict.reason);
    sweep = sweep_of(message_of<msg::Sweep>(bytes));
    ++sweeps_;
    return true;
  }

  const std::vector<std::string>& files() const override { return files_; }
  NamedCounts counts() const override { return {{"scans", sweeps_}}; }
  std::vector<std::string> remarks() const override { return frames_->remarks(); }
  std::vector<ImuReading> take_imu() override { return frames_->take_imu(); }

 private:
  std::unique_ptr<Frames> frames_;
  std::vector<std::string> files_;
  std::uint64_t sweeps_ = 0;
};

class RecordedPackets : public PacketSource {
 public:
  explicit RecordedPackets(std::unique_ptr<Frames> frames) : frames_(std::move(frames)) {}

  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    while (left_ == 0) {
      const auto head = frames_->next(FrameKind::kPackets);
      if (!head) return Read::kEnd;
      left_ = head->bytes;
    }
    RecordedPacket about{};
    if (left_ < sizeof about) throw frames_->foreign();
    frames_->read(&about, sizeof about);
    left_ -= sizeof about;
    if (left_ < about.bytes) throw frames_->foreign();
    payload_.resize(about.bytes);
    frames_->read(payload_.data(), payload_.size());
    left_ -= about.bytes;
    ++packets_;
    datagram = {payload_, about.received_ns, 0, 0};
    return Read::kDatagram;
  }

  std::vector<ImuReading> take_imu() override { return frames_->take_imu(); }
  NamedCounts counts() const override { return {{"packets_recorded", packets_}}; }
  std::string complaint() const override {
    std::string all;
    for (const std::string& remark : frames_->remarks()) all += (all.empty() ? "" : "; ") + remark;
    return all;
  }

 private:
  std::unique_ptr<Frames> frames_;
  std::vector<std::uint8_t> payload_;
  std::uint64_t left_ = 0;
  std::uint64_t packets_ = 0;
};

}  // namespace

Recording open_recording(const RecordingOptions& options) {
  auto frames = std::make_unique<Frames>(options);
  Recording recording;
  recording.identity = frames->identity();
  if (recording.identity.starts_with("packets ")) {
    recording.packets = std::make_unique<RecordedPackets>(std::move(frames));
  } else if (recording.identity.starts_with("messages ")) {
    recording.clouds = std::make_unique<RecordedMessages>(std::move(frames));
  } else {
    recording.clouds = std::make_unique<RecordedClouds>(std::move(frames));
  }
  return recording;
}

}  // namespace zloam::driver
