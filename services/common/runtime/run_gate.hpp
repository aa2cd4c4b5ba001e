#pragma once
// Which run a stage follows (docs/protocol.md, section 15). A run belongs to a driver, whose
// liveliness token names it. Without clock or transport; any thread.
//
// Principle: a driver that is present and was received lately is trusted, whatever others send.
// The followed run is left only for one with better evidence, and never for good:
//  - its own token is gone, and the other's is there;
//  - no driver has declared a token (a recording, a third party's driver), and the followed run has
//    been silent for kRunSilence_ns; if it had a token that is gone, for kGoneSilence_ns: messages
//    of a restarted driver may arrive through others before its own link is up.
// Times are of any monotonic clock, ns.

#include <cstdint>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <utility>

namespace zloam::runtime {

inline constexpr std::int64_t kRunSilence_ns = 2'000'000'000;
inline constexpr std::int64_t kGoneSilence_ns = 200'000'000;

class RunGate {
 public:
  /// The token of a driver, by its key, appeared or disappeared.
  void token(const std::string& key, std::uint64_t run, bool there);

  /// Whether a message of the run is accepted; may change the followed run. Whether a run is a
  /// replay is fixed at its first message.
  bool admit(std::uint64_t run, bool replay, std::int64_t now_ns);
  bool follows(std::uint64_t run) const;

 private:
  bool has_token(std::uint64_t run) const;
  bool is_silent(std::int64_t now_ns) const;
  bool may_follow(std::uint64_t run, bool silent) const;

  mutable std::mutex mutex_;
  /// (run, the token's key)
  std::set<std::pair<std::uint64_t, std::string>> tokens_;
  struct Followed {
    std::uint64_t run;
    bool replay;
    std::int64_t heard_ns;
    bool had_token;
  };
  std::optional<Followed> followed_;
};

}  // namespace zloam::runtime
