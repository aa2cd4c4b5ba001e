#pragma once
// What a replica of registration knows of the other replicas and of odometry: which replicas are
// alive and ready, and which sweeps are still missing.

#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/runtime/stage.hpp"
#include "common/zenoh/zenoh.hpp"
#include "registration/sharing.hpp"

namespace zloam::registration {

class Colleagues {
 public:
  /// on_change may be called on any thread.
  Colleagues(runtime::Stage& stage, std::function<void()> on_change);

  /// Instances with a token whose last status says that they are ready. Any thread.
  std::vector<std::string> members() const;
  std::optional<Progress> progress() const;

 private:
  void on_token(const zenoh::Sample& sample);
  void on_status(const zenoh::Sample& sample);
  void on_progress(const zenoh::Sample& sample);

  std::function<void()> on_change_;
  /// ZLOAM_FAULT_MEMBERS: a wrong list for tests
  std::optional<std::vector<std::string>> wrong_;
  mutable std::mutex mutex_;
  std::set<std::string> alive_;
  std::map<std::string, bool> ready_;
  std::optional<Progress> progress_;
  // Last: their callbacks must end before the members they use are destroyed.
  std::vector<zenoh::Subscriber> subscribers_;
};

}  // namespace zloam::registration
